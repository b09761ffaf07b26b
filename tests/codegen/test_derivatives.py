"""Jacobians by elimination against CasADi's, which carries derivatives along."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from slipangle.codegen.derivatives import jacobians
from tests.models.all_models import ALL_MODELS


def values(results, variables, points):
    """Ours and CasADi's at some points, stacked."""
    ours = ca.Function("ours", variables, [ca.densify(j) for j in jacobians(results, variables)])
    theirs = ca.Function("theirs", variables, [ca.densify(ca.jacobian(r, v)) for r in results for v in variables])
    return [[np.array(j.full()) for j in f.call(p)] for p in points for f in (ours, theirs)]


def agree(results, variables, points):
    both = values(results, variables, points)
    for ours, theirs in zip(both[::2], both[1::2], strict=True):
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-11 * (1.0 + np.nanmax(np.abs(b), initial=0.0)))


def products(f):
    ids = [f.instruction_id(k) for k in range(f.n_instructions())]
    return sum(i in (ca.OP_MUL, ca.OP_SQ, ca.OP_DIV, ca.OP_INV) for i in ids)


OPERATIONS = [  # of two operands, finite for all
    lambda a, b: a + b,
    lambda a, b: a - b,
    lambda a, b: a * b,
    lambda a, b: a / (1.5 + b * b),
    lambda a, b: ca.sin(a),
    lambda a, b: ca.atan(a) - 2 * b,
    lambda a, b: ca.atan2(a, 1.2 + ca.fabs(b)),
    lambda a, b: ca.fmax(a, b),
    lambda a, b: ca.fmin(a, 0.3 * b),
    lambda a, b: ca.sqrt(0.1 + a * a),
    lambda a, b: ca.if_else(a > b, a * a, ca.cos(b)),
    lambda a, b: ca.if_else(ca.logic_and(a > 0, b > 0), ca.log(ca.fabs(a)), b),
    lambda a, b: ca.exp(-a * a) ** 3,
    lambda a, b: ca.sign(a) * b,
]


@pytest.mark.parametrize("seed", range(30))
def test_random_expressions(seed):
    rng = np.random.default_rng(seed)
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    pool = [*ca.vertsplit(x), *ca.vertsplit(u), ca.SX(0.7)]
    for _ in range(60):
        a, b = (pool[rng.integers(max(0, len(pool) - 20), len(pool))] for _ in range(2))
        pool.append(OPERATIONS[rng.integers(len(OPERATIONS))](a, b))
    first, second = ca.vertcat(*pool[-3:], x[1], 2.0), ca.vertcat(pool[-8], -u[0])
    agree([first, second], [x, u], [[rng.normal(size=4), rng.normal(size=2)] for _ in range(5)])


@pytest.mark.parametrize("name", sorted(ALL_MODELS))
def test_models(name):
    model = ALL_MODELS[name]
    x, u = ca.SX.sym("x", model.n_states), ca.SX.sym("u", model.n_inputs)
    step, output, _ = model.functions
    try:
        results = [f.expand()(x, u) for f in (step, output)]
    except RuntimeError:
        pytest.skip("matrix expressions are differentiated by CasADi")
    rng = np.random.default_rng(0)
    agree(results, [x, u], [[0.1 * rng.normal(size=v.numel()) + 0.5 for v in (x, u)] for _ in range(3)])


def test_a_chain_behind_one_value_is_differentiated_once():
    x = ca.SX.sym("x", 5)
    slip = ca.sum1(x * ca.DM([1.0, 2.0, 3.0, 4.0, 5.0])) * x[0] + x[1] * x[2] * x[3] * x[4]
    force = slip
    for _ in range(10):
        force = force - 0.3 * ca.atan(2.0 * force)
    results = ca.vertcat(force * x[0], ca.sin(force), x[1] * force, force**2 + x[2])
    ours = ca.Function("ours", [x], [results, *jacobians([results], [x])], {"cse": True})
    theirs = ca.Function("theirs", [x], [results, ca.jacobian(results, x)], {"cse": True})
    assert products(ours) < 0.7 * products(theirs)


def test_what_a_condition_drops_may_have_infinite_derivatives():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    for f in (
        ca.if_else(x > 0, ca.sqrt(x), 0.0) + y,
        ca.if_else(x > 0, 3.0 * ca.sin(ca.sqrt(x * y)), x) * ca.cos(y),
        ca.if_else(x > 0, ca.if_else(y > 0, ca.log(x) * ca.log(y), x), y) ** 2,
        ca.exp(ca.if_else(x > 0, x**0.5 / (x * y), y)) + ca.if_else(x > 0, x, -x),
    ):
        points = [[0.0, 0.5], [0.0, 0.0], [0.7, 0.4], [-1.0, 2.0]]
        both = values([f], [x, y], points)
        for ours, theirs in zip(both[::2], both[1::2], strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-12)
        assert np.isfinite(both[0]).all()


def test_constants_and_what_only_conditions_ask_for():
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    result = ca.vertcat(3.0, ca.if_else(ca.sin(x[0]) > 0.2, u, 2 * u), ca.floor(x[1]), x[1])
    by_x, by_u = jacobians([result], [x, u])
    assert (by_x.shape, by_u.shape) == ((4, 2), (4, 1))
    np.testing.assert_array_equal(ca.DM(by_x), [[0, 0], [0, 0], [0, 0], [0, 1]])
    agree([result], [x, u], [[[0.1, 2.5], 1.0], [[1.1, -2.5], 1.0]])
    assert jacobians([ca.SX(0, 1)], [x])[0].shape == (0, 2)


def test_calls_and_matrix_expressions_are_differentiated_by_casadi():
    x = ca.SX.sym("x", 2)
    square = ca.Function("square", [x], [x * x], {"never_inline": True})
    y = ca.SX.sym("y", 2)
    agree(
        [
            square(
                y,
            )
            * y[0]
        ],
        [y],
        [[[1.0, 2.0]]],
    )
    z = ca.MX.sym("z", 2)
    np.testing.assert_allclose(
        ca.Function("f", [z], jacobians([ca.solve(ca.DM([[2, 1], [0, 1]]), z)], [z]))(0), [[0.5, -0.5], [0, 1]]
    )
