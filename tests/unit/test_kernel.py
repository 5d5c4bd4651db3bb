"""Kernels give the same results as NumPy."""

import casadi as ca
import numpy as np
import pytest

from valor.common.kernel import Expression, Kernel, clipped

pytestmark = pytest.mark.portable


def test_arrays_are_read_and_written_as_they_lie() -> None:
    rng = np.random.default_rng(0)
    vector, matrix, stack = rng.normal(size=3), rng.normal(size=(4, 3)), rng.normal(size=(2, 5, 3))
    product, turned, scaled = np.zeros(4), np.zeros((3, 4)), np.zeros((2, 5, 3))

    def expressions(vector: Expression, matrix: Expression, stack: Expression) -> tuple[Expression, ...]:
        return matrix @ vector, matrix.T, 2.0 * stack

    kernel = Kernel("some", expressions, (vector, matrix, stack), (product, turned, scaled))
    for _ in range(2):
        kernel()
        np.testing.assert_allclose(product, matrix @ vector)
        np.testing.assert_array_equal(turned, matrix.T)
        np.testing.assert_array_equal(scaled, 2.0 * stack)
        matrix += 1.0


def test_what_is_not_chosen_does_no_harm() -> None:
    value, result = np.zeros(1), np.zeros(1)
    kernel = Kernel("chosen", lambda x: [ca.if_else(x > 0.0, 1.0 / x, -1.0)], (value,), (result,))
    kernel()
    assert result[0] == -1.0


def test_what_is_no_number_does_not_become_a_limit() -> None:
    values, results = np.array((-2.0, 0.5, 2.0, np.nan)), np.zeros(4)
    Kernel("clipped", lambda x: [clipped(x, -1.0, 1.0)], (values,), (results,))()
    np.testing.assert_array_equal(results, (-1.0, 0.5, 1.0, np.nan))


@pytest.mark.parametrize(
    ("inputs", "outputs", "message"),
    [
        ([np.zeros((3, 3))[:, 1]], [np.zeros(3)], "contiguous"),
        ([np.zeros(3, dtype=np.float32)], [np.zeros(3)], "float64"),
        ([np.zeros(3)], [np.zeros(4)], r"result 0 is \(3, 1\), its array \(4, 1\)"),
    ],
)
def test_arrays_that_do_not_fit_are_named(inputs: list[np.ndarray], outputs: list[np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Kernel("wrong", lambda x: [x], inputs, outputs)


def test_nothing_is_read_while_it_is_written() -> None:
    array = np.zeros(6)
    with pytest.raises(ValueError, match="both read and written"):
        Kernel("both", lambda x: [x], [array[:4]], [array[2:]])
