"""Small arithmetic of the control loop as one call: CasADi expressions, evaluated in place on NumPy arrays.

A NumPy call on a vector of three costs half a microsecond, more when other processes have had the cache since, and the
control loop would need hundreds. The same as one expression costs a tenth of a microsecond, and two nanoseconds an
operation. Products of matrices as large as the model stay with BLAS, which does an operation in a tenth of that.

An expression has no branches: both sides of ``casadi.if_else`` are evaluated, and one is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from valor.common.arrays import FloatArray

Expression = Any
"""A ``casadi.SX``, for which there are no types."""


class Kernel:
    """Expressions of some arrays, evaluated into others."""

    def __init__(
        self,
        name: str,
        expressions: Callable[..., Sequence[Expression]],
        inputs: Sequence[FloatArray],
        outputs: Sequence[FloatArray],
    ) -> None:
        """Build the expressions and bind them to the arrays.

        Args:
            name: a word.
            expressions: takes one symbol an input and returns one expression an output, of the arrays' shapes: a
                column for (n,), (k·r, c) for (k, r, c).
            inputs: contiguous, read at every call; none of them overlaps an output.
            outputs: contiguous, written to.

        Raises:
            ValueError: an array that is not contiguous float64 or is both read and written, or an expression that does
                not fit its array.
        """
        for array in (*inputs, *outputs):
            if not array.flags.c_contiguous or array.dtype != np.float64:
                raise ValueError(f"kernel {name!r}: expected contiguous arrays of float64")
        if any(np.may_share_memory(one, other) for one in inputs for other in outputs):
            raise ValueError(f"kernel {name!r}: an array is both read and written")
        # CasADi's matrices lie column by column, NumPy's row by row.
        stored = [ca.SX.sym(f"{name}_{i}", *reversed(_shape(array))) for i, array in enumerate(inputs)]
        results = [ca.densify(ca.SX(each)) for each in expressions(*(symbol.T for symbol in stored))]
        for i, (result, array) in enumerate(zip(results, outputs, strict=True)):
            if result.shape != _shape(array):
                raise ValueError(f"kernel {name!r}: result {i} is {result.shape}, its array {_shape(array)}")
        function = ca.Function(name, stored, [result.T for result in results], {"cse": True})
        buffer: Any  # the stubs know only the calls with sizes
        buffer, self._evaluate = function.buffer()
        for i, array in enumerate(inputs):
            buffer.set_arg(i, array.data)
        for i, array in enumerate(outputs):
            buffer.set_res(i, array.data)
        self._alive = (buffer, inputs, outputs)  # what ``_evaluate`` works on

    def __call__(self) -> None:
        """Evaluate."""
        self._evaluate()


def _shape(array: FloatArray) -> tuple[int, int]:
    """Rows and columns as a matrix."""
    if array.ndim < 2:
        return array.size, 1
    return array.size // array.shape[-1], array.shape[-1]


def parts(column: Expression) -> Any:
    """The numbers of a column, one by one: what ``rotation`` takes for a quaternion or a vector."""
    return tuple(ca.vertsplit(column))


def pieces(column: Expression, sizes: Sequence[int]) -> list[Expression]:
    """A column cut into columns of these sizes, which are its own together."""
    return list(ca.vertsplit(column, np.cumsum((0, *sizes)).tolist()))


def by_rows(column: Expression) -> Expression:
    """(3k,) numbers as a (k, 3) matrix, row by row, as NumPy's ``ravel`` has it."""
    return ca.reshape(column, 3, column.shape[0] // 3).T


def clipped(value: Expression, lower: Expression, upper: Expression) -> Expression:
    """The value within limits; NaN stays NaN, where ``casadi.fmin`` and ``fmax`` would make a limit of it."""
    return ca.if_else(value > upper, upper, ca.if_else(value < lower, lower, value))
