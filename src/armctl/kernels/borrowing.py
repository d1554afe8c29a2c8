"""Compilation in which kernels borrow the arrays that they are called with, and count no references to them.

numba counts the references to each array's memory, also of views such as `rows[i]`, by atomic operations: a third of
the processor time of `reach_mppi`. Who calls a kernel keeps the arrays meanwhile, also those in a `Bound`. Only a
kernel that returns arrays, which may be views of its arguments, counts references to them.
"""

from typing import Any

from numba import types
from numba.core import cgutils
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering


class _BorrowingLower(Lower):  # type: ignore[misc]
    @property
    def _borrows(self) -> bool:
        return not _has_arrays(self.fndesc.restype)

    def extract_function_arguments(self) -> list[Any]:
        """Return the values of the arguments; arrays among them have no owner."""
        self.fnargs: list[Any] = super().extract_function_arguments()
        if self._borrows:
            kinds = self.fndesc.argtypes
            self.fnargs = [self._borrowed(kind, value) for kind, value in zip(kinds, self.fnargs, strict=True)]
        return self.fnargs

    def lower_expr(self, kind: types.Type, expression: Any) -> Any:
        """Return the value of an expression; arrays of a structure, which is an argument, have no owner, either."""
        value = super().lower_expr(kind, expression)
        is_field = expression.op == "getattr" and isinstance(self.typeof(expression.value.name), types.StructRef)
        if not is_field or not self._borrows:
            return value
        self.decref(kind, value)
        return self._borrowed(kind, value)

    def _borrowed(self, kind: types.Type, value: Any) -> Any:
        if isinstance(kind, types.Array):
            array = self.context.make_array(kind)(self.context, self.builder, value)
            array.meminfo = cgutils.get_null_value(array.meminfo.type)
            return array._getvalue()
        if isinstance(kind, types.BaseTuple):
            for i, each in enumerate(kind):
                part = self._borrowed(each, self.builder.extract_value(value, i))
                value = self.builder.insert_value(value, part, i)
        return value


def _has_arrays(kind: types.Type) -> bool:
    """Return True if a value of a type may be, or have, an array."""
    if isinstance(kind, types.BaseTuple):
        return any(map(_has_arrays, kind))
    return not isinstance(kind, types.Number | types.Boolean | types.NoneType)


@register_pass(mutates_CFG=True, analysis_only=False)
class _BorrowingLowering(NativeLowering):  # type: ignore[misc]
    _name = "borrowing_lowering"

    @property
    def lowering_class(self) -> type[Lower]:
        return _BorrowingLower


class BorrowingCompiler(CompilerBase):  # type: ignore[misc]
    """Compiler of kernels."""

    def define_pipelines(self) -> list[Any]:
        """Return numba's passes, with another one for the arguments."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (_BorrowingLowering if each is NativeLowering else each, label) for each, label in passes.passes
        ]
        passes.finalize()
        return [passes]
