"""Random problems of several phases: all our solvers and Ipopt end at the same inputs, or name what has none."""

import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.control.phases import Phases
from slipangle.models.custom import Ode
from slipangle.ops import cos, exp, sin, tanh
from slipangle.optimal.end import TerminalCost
from slipangle.optimal.engine import Start
from slipangle.optimal.setpoints import setpoint
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from tests.optimal.nearby import is_local_optimum
from tests.optimal.test_agreement import CLOSE, GAINS, MODEL, SOLVED, P, ours_and_ipopt

CART = Ode(
    f=lambda x, u, p: [x[1], u[0] - p.drag * x[1] - 0.2 * sin(x[0])],
    states=("s", "w"),
    inputs=("u",),
    params={"drag": 0.3},
    dt=0.15,
)
BOUNDS = {"u": 3.0, "v": 2.0}
CARTS = {"horizon": 4, "controls": ("u",), "Q": Weights(s=2.0, w=0.3), "R": Weights(u=0.2), "limits": Limits(u=3.0)}
ARMS = {
    "horizon": 5,
    "controls": ("u", "v"),
    "Q": Weights(a=4.0, b=0.5, c=2.0),
    "R": Weights(u=0.1, v=0.2),
    "limits": Limits(**BOUNDS),
}


def cart(**settings):
    return MPC(CART, **(CARTS | settings))


def arm(model=MODEL, **settings):
    return MPC(model, **(ARMS | settings))


def landing(x):
    """From the cart to the arm."""
    return [0.7 * x[0], x[1] * cos(x[0]), 0.2 * tanh(x[0] * x[1])]


def leaving(x):
    """From the arm to the cart."""
    return [x[0] + 0.1 * x[2], x[1] - 0.3 * x[1] * x[2]]


def later(x):
    """A part that is dropped takes some of the speed with it."""
    return [x[0], 0.8 * x[1], x[2] + 0.1 * sin(x[1])]


SOFT = {"limits": Limits(**BOUNDS, b=1.0, y=1.2), "slack": Weights(y=20.0), "slack_linear": Weights(y=3.0, b=30.0)}
ENDED = Weights(a=30.0, b=5.0, c=2.0, duration=1.0)
PHASES = {
    "one model twice": lambda: ([arm(), arm(S=Weights(u=0.4), rates=Limits(u=20.0))], None),
    "another model": lambda: ([cart(S=Weights(u=0.2)), arm(S=Weights(u=0.2), rates=Limits(u=15.0))], [landing]),
    "three phases": lambda: ([cart(), arm(**SOFT), cart(terminal=Weights(s=9.0, w=1.0))], [landing, leaving]),
    "an end that is kept": lambda: (
        [arm(limits=Limits(**BOUNDS, b=1.6)), arm(terminal_limits=Limits(a=(0.0, 0.0), b=0.2))],
        [later],
    ),
    "a matrix at each end": lambda: ([arm(terminal=TerminalCost(("a", "b", "u"), k * P)) for k in (1.0, 3.0)], None),
    "free durations": lambda: (
        [cart(duration=(0.3, 1.2), terminal=Weights(s=9.0, duration=1.0)), arm(duration=(0.3, 1.5), terminal=ENDED)],
        [landing],
    ),
    "a free parameter and Huber costs": lambda: (
        [
            cart(free=Limits(drag=(0.1, 1.0)), terminal=Weights(s=9.0, w=1.0, drag=0.5), huber=Weights(s=0.3)),
            arm(huber=Weights(a=0.3, c=0.2)),
        ],
        [landing],
    ),
    "equations that are solved": lambda: ([cart(), arm(SOLVED, **SOFT)], [landing]),
    "costs that are no squares": lambda: (
        [
            cart(),
            arm(
                terms={"heat": lambda x, u, p: 0.1 * u[0] ** 4 + 0.1 * exp(x[2] * x[0])},
                limits=Limits(**BOUNDS, heat=(-np.inf, 0.0)),
                slack_linear=Weights(heat=1.0),
            ),
        ],
        [landing],
    ),
}


def solvers(kind):
    """The phases for each solver, Ipopt last."""
    return [Phases(problems, links=links, solver=e) for e in ours_and_ipopt() for problems, links in [PHASES[kind]()]]


def drawn(phases, rng):
    """A state, what is wanted of each phase, by name, and the input before."""
    wanted = []
    for ocp in phases.problems:
        said = {name: rng.uniform(0.3, 2.0) for name in GAINS if name in ocp.exogenous}
        said |= {name: 0.4 for name in ("drag",) if name in ocp.references}
        wanted.append(said | {name: rng.uniform(-1.0, 1.0) for name in "abcsw" if name in ocp.references})
    first = phases.problems[0]
    return rng.uniform(-1.0, 1.0, first.model.n_states), wanted, rng.uniform(-1.0, 1.0, len(first.controls))


def near(ours, theirs):
    """Whether plans are the same in all phases."""
    return all(
        a.u == pytest.approx(b.u, abs=CLOSE) and a.decided == pytest.approx(b.decided, abs=CLOSE)
        for a, b in zip(ours.phases, theirs.phases, strict=True)
    )


def stays(judge, ours, x, wanted, applied):
    """Whether Ipopt finds nothing better beside a plan."""
    linked, engine = judge._parts
    references = [setpoint(ocp, said) for ocp, said in zip(judge.problems, wanted, strict=True)]
    u0 = linked.resting(applied, references, [None] * len(references))
    here = Start(
        x=np.concatenate([x, np.zeros(linked.model.n_states - len(x))]),
        applied=u0,
        reference=linked.spread(u0, references),
        guess_u=ours.start.u,
        guess_x=ours.start.x,
    )
    return is_local_optimum(engine, here, ours.start, CLOSE)


def compare(kind, count, seed=1):
    """How many of so many problems have an answer; see `tests.optimal.test_agreement.compare`."""
    posed, rng, solved = solvers(kind), np.random.default_rng(seed), 0
    for _ in range(count):
        x, wanted, applied = drawn(posed[0], rng)
        *plans, theirs = [phases.plan(x, wanted, applied=applied) for phases in posed]
        ours, what = plans[0], (x.tolist(), wanted, [plan.status for plan in plans], theirs.status)
        if not theirs.status.solved and not ours.status.solved:
            assert all(plan.status is Status.INFEASIBLE for plan in plans), what
            continue
        assert all(plan.status is Status.SOLVED for plan in plans), what
        assert all(near(ours, other) for other in plans[1:]), what
        if not (theirs.status.solved and near(ours, theirs)):
            assert stays(posed[-1], ours, x, wanted, applied), what
        solved += 1
    return solved


@pytest.mark.parametrize("kind", [pytest.param("three phases", marks=pytest.mark.slow), "free durations"])
def test_a_few_random_phases_end_the_same(kind):
    assert compare(kind, 6) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", PHASES)
def test_many_random_phases_end_the_same(kind):
    assert compare(kind, 40, seed=2) >= 20
