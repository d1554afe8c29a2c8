"""Compiled arithmetic: plain loops over numbers, made into machine code by numba.

A kernel takes arrays and scalars, writes results into arrays that it is given, and checks nothing: its callers do. The
tests hold each to a readable reference in NumPy.
"""
