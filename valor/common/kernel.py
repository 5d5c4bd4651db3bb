"""Arithmetic on small vectors in the control loop: CasADi expressions, evaluated in place on NumPy arrays.

An expression costs 0.1 µs, and 2 ns per operation; one NumPy call on a vector of three costs 0.5 µs, or more. Products
of matrices of the model's size remain with BLAS. Both sides of ``casadi.if_else`` are evaluated.
"""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from valor.common.arrays import FloatArray

Expression = Any
"""A ``casadi.SX``, which has no type stubs."""


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
            name: an identifier.
            expressions: takes one symbol for each input and returns one expression for each output, of the arrays'
                shapes: a column for (n,), (k·r, c) for (k, r, c).
            inputs: contiguous, read at every call; no overlap with outputs.
            outputs: contiguous, written at every call.

        Raises ValueError: an array is not contiguous float64, is both input and output, or has another shape.
        """
        for array in (*inputs, *outputs):
            if not array.flags.c_contiguous or array.dtype != np.float64:
                raise ValueError(f"kernel {name!r}: expected contiguous arrays of float64")
        if any(np.may_share_memory(one, other) for one in inputs for other in outputs):
            raise ValueError(f"kernel {name!r}: an array is both read and written")
        # CasADi stores matrices by columns, NumPy by rows.
        stored = [ca.SX.sym(f"{name}_{i}", *reversed(_shape(array))) for i, array in enumerate(inputs)]
        results = [ca.densify(ca.SX(each)) for each in expressions(*(symbol.T for symbol in stored))]
        for i, (result, array) in enumerate(zip(results, outputs, strict=True)):
            if result.shape != _shape(array):
                raise ValueError(f"kernel {name!r}: result {i} is {result.shape}, its array {_shape(array)}")
        function = ca.Function(name, stored, [result.T for result in results], {"cse": True})
        buffer: Any  # the stubs have only the calls with sizes
        buffer, self._evaluate = function.buffer()
        for i, array in enumerate(inputs):
            buffer.set_arg(i, array.data)
        for i, array in enumerate(outputs):
            buffer.set_res(i, array.data)
        self._alive = (buffer, inputs, outputs)  # memory of ``_evaluate``

    def __call__(self) -> None:
        """Evaluate."""
        self._evaluate()


def _shape(array: FloatArray) -> tuple[int, int]:
    if array.ndim < 2:
        return array.size, 1
    return array.size // array.shape[-1], array.shape[-1]


def parts(column: Expression) -> Any:
    """The numbers of a column, as ``rotation`` expects a quaternion or a vector."""
    return tuple(ca.vertsplit(column))


def pieces(column: Expression, sizes: Sequence[int]) -> list[Expression]:
    """A column divided into columns of these sizes."""
    return list(ca.vertsplit(column, np.cumsum((0, *sizes)).tolist()))


def by_rows(column: Expression) -> Expression:
    """(3k,) numbers as a (k, 3) matrix, by rows as NumPy's ``ravel``."""
    return ca.reshape(column, 3, column.shape[0] // 3).T


def clipped(value: Expression, lower: Expression, upper: Expression) -> Expression:
    """The value within limits; NaN remains NaN, while ``casadi.fmin`` and ``fmax`` would return a limit."""
    return ca.if_else(value > upper, upper, ca.if_else(value < lower, lower, value))


def turned(vector: Expression) -> Expression:
    """(3, 3) rotation by a rotation vector [rad] (Rodrigues)."""
    angle = ca.fmax(ca.norm_2(vector), 1e-12)
    cross = ca.skew(vector / angle)
    return ca.SX.eye(3) + ca.sin(angle) * cross + (1.0 - ca.cos(angle)) * (cross @ cross)


def about(axis: FloatArray, angle: Expression) -> Expression:
    """(3, 3) rotation about a unit axis (3,) by an angle [rad] (Rodrigues)."""
    x = ca.sparsify(ca.DM(np.cross(axis, np.eye(3)).T))
    return ca.SX.eye(3) + ca.sin(angle) * x + (1.0 - ca.cos(angle)) * (x @ x)


def rotation_vector(turn: Expression) -> Expression:
    """(3,) [rad] as ``rotation.rotation_vector``."""
    sine = 0.5 * ca.vertcat(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
    norm = ca.norm_2(sine)
    return sine * (ca.atan2(norm, 0.5 * (ca.trace(turn) - 1.0)) / ca.fmax(norm, 1e-12))


def roll_pitch_yaw(matrix: Expression) -> tuple[Expression, Expression, Expression]:
    """Inverse of ``from_roll_pitch_yaw`` for a (3, 3) expression and a pitch below π/2 [rad]."""
    forward = ca.norm_2(matrix[:2, 0])
    return (
        ca.atan2(matrix[2, 1], matrix[2, 2]),
        ca.atan2(-matrix[2, 0], forward),
        ca.atan2(matrix[1, 0], matrix[0, 0]),
    )
