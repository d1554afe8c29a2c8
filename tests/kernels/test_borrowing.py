"""Kernels count no references to the arrays that they borrow, and keep what they return alive."""

import sys

import numpy as np
import pytest

from armctl.kernels import arm, compiling
from armctl.kernels.compiling import bound, compiled
from armctl.kinematics import ArmModel


@compiled
def first_of(row):
    return row[0]


@compiled
def sum_of_firsts(rows):
    total = 0.0
    for i in range(len(rows)):
        total += first_of(rows[i])
    return total


@compiled
def last_row(rows):
    return rows[-1]


@compiled
def last_rows(rows, number):
    return rows[len(rows) - number :], number


@compiled
def add_to_first(number, bound):
    rows, (factors, _) = bound.arguments
    for i in range(len(rows)):
        row = rows[i]
        row[0] += number * factors[i]


@compiled
def first_row(bound):
    rows, _ = bound.arguments
    return rows[0]


@compiled
def sum_of_made(number):
    rows = np.empty((number, 3))
    for i in range(number):
        rows[i] = i
    return sum_of_firsts(rows) + last_row(rows)[1]


@compiled
def swapped(first, second, times):
    for _ in range(times):
        first, second = second, first
    return first[0]


@pytest.fixture
def llvm_of(monkeypatch):
    """The code of a kernel, which is compiled now."""
    monkeypatch.setattr(compiling, "_FOLDER", None)

    def code(kernel, *arguments):
        copy_of_kernel = compiled(kernel.py_func)
        copy_of_kernel(*arguments)
        (llvm,) = copy_of_kernel.inspect_llvm().values()
        return llvm

    return code


def test_no_references_are_counted_to_views_of_arguments(llvm_of):
    llvm = llvm_of(arm.tips, ArmModel("ur5").joints, np.zeros((3, 6)), np.zeros((3, 3)))
    assert "@NRT_incref(" not in llvm
    assert "@NRT_decref(" in llvm, "of its own arrays"


def test_no_references_are_counted_to_what_is_bound(llvm_of):
    rows = np.zeros((2, 3))
    arguments = bound((rows, (np.array([1.0, 10.0]), 5)))
    assert "@NRT_incref(" not in llvm_of(add_to_first, 2, arguments)
    for _ in range(4):
        add_to_first(2, arguments)
    assert rows[:, 0].tolist() == [10.0, 100.0]


def test_what_is_bound_lives_as_long_as_a_row_of_it():
    for n in range(20):
        row = first_row(bound((np.full((50, 1000), float(n)), (np.zeros(1), 0))))
        np.full((50, 1000), -1.0)
        assert (row == n).all()


def test_what_is_returned_stays_alive():
    for n in range(20):
        row = last_row(np.full((50, 1000), float(n)))
        rows, _ = last_rows(np.full((50, 1000), float(n)), 2)
        np.full((50, 1000), -1.0)
        assert (row == n).all()
        assert (rows == n).all()


def test_own_arrays_are_passed_on():
    assert sum_of_made(5) == 0 + 1 + 2 + 3 + 4 + 4


def test_arguments_are_owned_by_the_caller_before_and_after():
    first, second = np.array([1.0]), np.array([2.0])
    before = sys.getrefcount(first), sys.getrefcount(second)
    assert [swapped(first, second, times) for times in (0, 1, 2, 3)] == [1, 2, 1, 2]
    assert (sys.getrefcount(first), sys.getrefcount(second)) == before
