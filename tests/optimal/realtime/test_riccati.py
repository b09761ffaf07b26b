"""Quadratic programs by stages: the condensed solver's answer, DAQP's and Ipopt's, on random problems of every kind."""

import pickle
from dataclasses import dataclass, replace

import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError
from slipangle.ops import matmul
from slipangle.optimal.engine import Start
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.interpreted import InterpretedEngine
from slipangle.optimal.realtime.program import source
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from tests.optimal.linear import Linear

pytestmark = pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())


@dataclass(frozen=True, eq=False)
class Varying(Linear):
    """x+ = (A + w A1) x + B u + w c, another one at every stage."""

    A1: np.ndarray = None
    c: np.ndarray = None

    def step(self, x, u):
        n = self.B.shape[1]
        return matmul(self.A, x) + matmul(self.B, u[:n]) + u[n] * (matmul(self.A1, x) + self.c)

    def output(self, x, u):
        return matmul(self.C, x) + matmul(self.D, u[: self.B.shape[1]])


def model(seed, through=0.0):
    rng = np.random.default_rng(seed)
    n, m = 5, 2
    A = 0.9 * np.eye(n) + 0.25 * rng.standard_normal((n, n))
    return Varying(
        A=A / max(1.0, np.abs(np.linalg.eigvals(A)).max() / 1.05),
        B=rng.standard_normal((n, m)),
        C=rng.standard_normal((2, n)),
        D=through * rng.standard_normal((2, m)),
        A1=0.2 * rng.standard_normal((n, n)),
        c=0.3 * rng.standard_normal(n),
        states=tuple("abcde"),
        inputs=("u", "v", "w"),
        outputs=("y", "z"),
    )


TWO = {"controls": ("u", "v"), "Q": Weights(a=1.0, b=0.5, y=2.0), "R": Weights(u=0.05, v=0.02)}
BOX = Limits(u=1.0, v=(-0.5, 2.0))
STATES = Limits(u=1.0, v=(-0.5, 2.0), c=0.6, y=(-0.4, 0.9), z=(-float("inf"), 1.5))
KINDS = {
    "free": {},
    "box": {"limits": BOX},
    "changes": {"limits": BOX, "S": Weights(u=0.3, v=0.1), "rates": Limits(u=4.0, v=(-2.0, 6.0))},
    "states": {"limits": STATES},
    "soft": {"limits": STATES, "slack": Weights(c=30.0, y=10.0, z=5.0)},
    "exact": {"limits": STATES, "slack_linear": Weights(c=20.0, y=10.0, z=3.0)},
    "both": {
        "limits": STATES,
        "slack": Weights(c=30.0, y=2.0),
        "slack_linear": Weights(c=3.0, y=4.0, z=2.0),
        "S": Weights(u=0.3),
        "rates": Limits(v=(-2.0, 6.0)),
    },
    "end": {"limits": BOX, "Q": Weights(a=1.0), "terminal": Weights(a=50.0, b=50.0, c=20.0)},
}


def problem(kind, qp, *, seed=0, through=0.0, steps=None):
    options = {**TWO, **KINDS[kind]}
    n = 18 if steps is None else len(steps)
    solver = RealTime(iterations=0, qp=qp, hessian="gauss-newton")  # none other is compiled for what has no answer
    return MPC(model(seed, through), horizon=n, steps=steps, solver=solver, **options)


def draw(ocp, rng):
    """A state, references and a guess; mostly with limits that matter."""
    n = ocp.horizon
    return Start(
        x=rng.standard_normal(5) * rng.choice([0.1, 0.5, 1.5]),
        applied=rng.uniform([-1.0, -0.5], [1.0, 2.0]),
        reference=Reference(
            tracked=rng.standard_normal((n + 1, len(ocp.references))) * rng.choice([0.0, 0.5, 2.0]),
            exogenous=rng.uniform(-1, 1, (n + 1, 1)),
        ),
        guess_u=rng.uniform(-0.5, 1.0, (n, 2)),
        guess_x=rng.standard_normal((n + 1, 5)),
    )


def both(kind, seeds, **options):
    """Answers of the two ways, how often each status came, and how often stages were gone by."""
    ways = [problem(kind, qp, **options) for qp in ("condensed", "riccati")]
    engines = [mpc.engine for mpc in ways]
    statuses, worst, by_stages = {}, 0.0, 0
    for seed in seeds:
        start = draw(ways[0].ocp, np.random.default_rng([seed, 5]))
        one, other = (engine.solve(start) for engine in engines)
        assert one.status is other.status, (kind, seed)
        statuses[one.status] = statuses.get(one.status, 0) + 1
        by_stages += int(engines[1].counts["by_stages"])
        if one.status is Status.SOLVED:
            worst = max(worst, float(np.abs(one.u - other.u).max()))
            assert other.cost == pytest.approx(one.cost, rel=1e-9, abs=1e-9)
    return statuses, worst, by_stages


def check(kind, seeds, **options):
    statuses, worst, by_stages = both(kind, seeds, **options)
    assert set(statuses) <= {Status.SOLVED, Status.INFEASIBLE, Status.FAILED}
    assert statuses[Status.SOLVED] >= 0.5 * len(seeds)
    assert worst <= 1e-8
    assert by_stages >= 0.99 * statuses[Status.SOLVED]
    return statuses


def test_the_answer_is_the_condensed_solvers():
    check("both", range(100))


def test_what_cannot_be_kept_is_named_the_same():
    assert check("states", range(60))[Status.INFEASIBLE] >= 5


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"through": 0.5}, {"steps": (1, 1, 2, 1, 3, 2, 4, 1)}, {"seed": 1}], ids=str)
@pytest.mark.parametrize("kind", KINDS)
def test_a_thousand_problems_of_every_kind(kind, options):
    """With inputs in the outputs, with stages of several steps, and with another model."""
    check(kind, range(1000), **options)


@pytest.mark.parametrize("kind", ["both"])
def test_the_answer_is_daqps_and_ipopts(kind):
    mpc = problem(kind, "riccati")
    daqp, ipopt = InterpretedEngine(mpc.ocp, RealTime(iterations=0), None), replace(mpc, solver="ipopt").engine
    for seed in range(6):
        start = draw(mpc.ocp, np.random.default_rng([seed, 5]))
        ours = mpc.engine.solve(start)
        assert ours.status is Status.SOLVED
        assert mpc.engine.counts["by_stages"]
        assert daqp.solve(start).u == pytest.approx(ours.u, abs=1e-7)  # each slack has a curvature of 1e-9 there
        assert ipopt.solve(start).u == pytest.approx(ours.u, abs=2e-6)


def drive(mpc, steps, previous=None, copies=False):
    """Plans of a drive; with copies, of a memory that no work area holds."""
    rng, plans, x = np.random.default_rng(3), [], np.array([1.0, -0.5, 0.5, 0.2, 0.8])
    reference = draw(mpc.ocp, rng).reference
    for _ in range(steps):
        previous = mpc.plan(x, reference, previous)
        if copies:
            previous = pickle.loads(pickle.dumps(previous))
        plans.append(previous)
        x = previous.x[1] + 0.02 * rng.standard_normal(5)
    return plans


def test_a_drive_is_the_condensed_solvers_and_hangs_on_no_work_area():
    ways = [replace(problem("both", qp), solver=RealTime(qp=qp)) for qp in ("condensed", "riccati")]
    one, other = (drive(mpc, 25) for mpc in ways)
    for a, b in zip(one, other, strict=True):
        assert b.status is a.status
        assert b.u == pytest.approx(a.u, abs=1e-8)
    for a, b in zip(other, drive(ways[1], 25, copies=True), strict=True):
        assert (a.u == b.u).all()


def test_a_limit_that_is_taken_away_leaves_nothing_behind():
    """Its slope stayed in the factor, so that every program after it went by an interior point and was condensed."""
    mpc = problem("both", "riccati")
    with_limits = draw(mpc.ocp, np.random.default_rng([2, 5]))
    assert mpc.engine.solve(with_limits).status is Status.SOLVED
    none = np.full_like(mpc.ocp.limits_at_nodes, [-np.inf, np.inf])
    without = replace(with_limits, reference=replace(with_limits.reference, limits=none))
    free = mpc.engine.solve(without)
    counts = mpc.engine.counts
    assert counts["by_stages"]
    fresh = problem("both", "riccati").engine
    assert (fresh.solve(without).u == free.u).all()
    assert fresh.counts == counts


def test_few_factors_put_the_rows_of_the_plan_before_right():
    """An interior point alone takes a dozen."""
    counts, previous, rng = [], None, np.random.default_rng(3)
    mpc = replace(problem("both", "riccati"), solver=RealTime(qp="riccati"))
    x, goal = np.array([1.0, -0.5, 0.5, 0.2, 0.8]), Reference(tracked=np.zeros((19, 3)), exogenous=np.zeros((19, 1)))
    for _ in range(25):
        previous = mpc.plan(x, goal, previous)
        x = previous.x[1] + 0.02 * rng.standard_normal(5)
        counts.append(mpc.engine.counts)
    assert all(c["by_stages"] for c in counts)
    assert np.mean([c["qp_iterations"] / c["iterations"] for c in counts[1:]]) <= 5


def test_where_no_rows_are_known_an_interior_point_finds_them():
    """Few factors put right what it leaves, none of which is condensed."""
    engine, ocp, factors = problem("both", "riccati").engine, problem("both", "riccati").ocp, []
    for k in range(30):
        engine.solve(draw(ocp, np.random.default_rng([7, k])))
        assert engine.counts["by_stages"]
        factors.append(engine.counts["qp_iterations"] / engine.counts["iterations"])
    assert max(factors) > 12  # beyond what is tried from the rows of the plan before
    assert np.mean(factors) < 14


def test_a_solve_ends_at_its_deadline():
    start = problem("both", "riccati")
    late = replace(start, deadline=1e-9).engine.solve(draw(start.ocp, np.random.default_rng(0)))
    assert late.status is Status.TIME_OUT


def test_only_long_horizons_have_both_ways():
    mpc = problem("box", "auto")
    for qp, horizon, expected in (
        ("auto", 3, False),
        ("auto", 200, True),
        ("condensed", 200, False),
        ("riccati", 3, True),
    ):
        ocp = replace(mpc, horizon=horizon).ocp
        assert ("#define RICCATI 1" in source(ocp, qp=qp)) is expected


def test_a_way_that_is_none_is_named():
    with pytest.raises(ParameterError, match=r"qp is 'dense'.*'condensed'"):
        RealTime(qp="dense")
