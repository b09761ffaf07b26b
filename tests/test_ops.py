"""Elementary functions of numbers of any type, arrays, symbols and tracers are those of their own library."""

import casadi as ca
import numpy as np
import pytest

from slipangle import ops

UNARY = ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "sqrt", "fabs", "sign")
NUMBERS = (0.3, 1, np.float64(0.3), np.float32(0.3), np.int64(1), np.array(0.3), np.array([0.3, 0.7]), ca.DM(0.3))


def plainly(value):
    return np.asarray(value, dtype=float).ravel()


@pytest.mark.parametrize("x", NUMBERS, ids=lambda x: type(x).__name__)
def test_numbers_of_any_type_give_what_numpy_gives(x):
    for name in UNARY:
        wanted = getattr(np, name)(plainly(x))
        assert plainly(getattr(ops, name)(x)) == pytest.approx(wanted, rel=1e-6)
    assert plainly(ops.maximum(x, 0.5)) == pytest.approx(np.maximum(plainly(x), 0.5))
    assert plainly(ops.where(plainly(x)[0] > 0.5, x, 2.0)) == pytest.approx(
        np.where(plainly(x)[0] > 0.5, plainly(x), 2)
    )
    assert ops.is_symbolic(0.1, x) is isinstance(x, ca.DM)
    assert not ops.is_traced(0.1, x)


@pytest.mark.parametrize("x", NUMBERS, ids=lambda x: type(x).__name__)
def test_numbers_of_any_type_stack(x):
    made = ops.stack([x, 2, 0.5])
    assert made.shape[0] == 3
    rows = np.array(made).reshape(3, -1)
    assert rows[0] == pytest.approx(plainly(x))
    assert (rows[1:] == [[2.0], [0.5]]).all()
    assert isinstance(made, ca.DM) or made.dtype == float


def test_symbols_among_numbers_stay_symbols():
    x = ca.SX.sym("x")
    for made in (ops.stack([0.1, x]), ops.maximum(0.1, x), ops.maximum(x, np.float64(0.1)), ops.where(True, 0.1, x)):
        assert isinstance(made, ca.SX)
        assert ops.is_symbolic(0.1, made)


def test_tracers_among_numbers_stay_tracers():
    jax = pytest.importorskip("jax")

    def f(x):
        made = ops.stack([0.1, ops.sin(x), ops.maximum(0.2, x)])
        assert ops.is_traced(0.1, made)
        return made.sum()

    assert float(jax.grad(f)(0.7)) == pytest.approx(np.cos(0.7) + 1.0, rel=1e-6)
