"""What a plan of several phases begins with, and by when it must end."""

import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.control.phases import Phases
from slipangle.errors import ParameterError
from slipangle.models.custom import Ode
from slipangle.ops import sin
from slipangle.optimal.engine import Engine
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.solution import Solution, Status
from slipangle.optimal.terms import Limits, Weights
from tests.control.test_phases import first, link, second, swinging

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler was found")


def pendulum(dt=0.1, **settings):
    """Hangs at 0, stands at pi and -pi; swung up in two phases, the second with more damping."""
    model = Ode(
        f=lambda x, u, p: [x[1], -9.81 * sin(x[0]) - p.drag * x[1] + u[0]],
        states=("phi", "rate"),
        inputs=("torque",),
        params={"drag": settings.pop("drag", 0.0)},
        dt=dt,
    )
    given = {"horizon": 15, "Q": Weights(rate=1e-3), "R": Weights(torque=0.1), "limits": Limits(torque=30.0)}
    return MPC(model, **(given | settings))


@pytest.mark.parametrize("solver", ["realtime", "none", "ipopt"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_phases_begin_with_guesses_of_their_own(solver, side, monkeypatch):
    if solver == "none":
        monkeypatch.setenv("SLIPANGLE_CC", "none")
    down, square = pendulum(), {"square": lambda x, u, p: x[0] ** 2}
    ends = Limits(square=(np.pi**2, np.pi**2), rate=(0.0, 0.0))
    up = pendulum(drag=0.2, terms=square, terminal_limits=ends)
    backend = Ipopt(tolerance=1e-10) if solver == "ipopt" else RealTime(iterations=0, max_iterations=200)
    swing = Phases([down, up], solver=backend)
    own = [down.guess(x={"phi": (0.0, 0.5 * side * np.pi)}), up.guess(x={"phi": (0.5 * side * np.pi, side * np.pi)})]
    plan = swing.plan(np.zeros(2), [{}, {}], own)
    assert plan.status is Status.SOLVED
    assert plan.phases[-1].x[-1] == pytest.approx([side * np.pi, 0.0], abs=1e-8)


class Recorder(Engine):
    """Keeps what it was to start from, and answers that."""

    def build(self, ocp, deadline):
        self.problem, self.deadline, self.left = ocp, deadline, None
        return self

    def allow(self, seconds):
        self.left = seconds

    def solve(self, start):
        self.start = start
        return Solution(u=start.guess_u, x=start.guess_x, status=Status.SOLVED, cost=0.0, iterations=1, violation=0.0)


def test_a_guess_of_one_phase_leads_into_the_next():
    recorder = Recorder()
    phases = Phases([first(), second()], links=[link], solver=recorder)
    goals, x = [{"s": 1.0, "v": 0.0}, {"phi": 0.3}], np.array([0.5, 0.1])
    plan = phases.plan(x, goals, [first().guess(u={"a": -1.5}), None], applied=np.array([0.4]))
    a = plan.phases[0]
    model = first().model
    assert np.array_equal(a.u, np.full((6, 1), -1.5))
    for i in range(6):
        assert a.x[i + 1] == pytest.approx(np.asarray(model.step(a.x[i], a.u[i])).ravel(), abs=1e-12)
    b = plan.phases[1]
    assert b.x[0] == pytest.approx(link(a.x[-1]), abs=1e-12)
    assert np.array_equal(b.u, np.tile([-1.5, 0.0], (8, 1)))  # what goes on is held
    later = second().guess(x={"phi": (0.2, 0.9)}, u={"fan": 5.0})
    plan = phases.plan(x, goals, [None, later], applied=np.array([0.4]))
    assert np.array_equal(plan.phases[0].u, np.full((6, 1), 0.4))
    b = plan.phases[1]
    assert b.x[:, 0] == pytest.approx(np.linspace(0.2, 0.9, 9), abs=1e-12)  # from the first on
    assert np.ptp(b.x[:, 1:], axis=0) == pytest.approx([0.0, 0.0])
    assert b.x[0, 1:] == pytest.approx(link(plan.phases[0].x[-1])[1:], abs=1e-12)
    assert np.array_equal(b.u, np.tile([0.4, 1.0], (8, 1)))  # within its limits
    first_x = first().guess(x=np.array([[9.0, 9.0], [1.0, 0.0]]))
    plan = phases.plan(x, goals, [first_x, None])
    assert np.array_equal(plan.phases[0].x[0], x)
    assert plan.phases[0].x[1:] == pytest.approx(np.linspace([9.0, 9.0], [1.0, 0.0], 7)[1:], abs=1e-12)


@pytest.mark.filterwarnings("ignore:phase .. the duration makes stages of")
def test_durations_are_guessed_phase_by_phase():
    recorder = Recorder()
    timed = [second(duration=(0.1, 2.0)), second(duration=(0.2, 3.0))]
    phases = Phases(timed, solver=recorder)
    plan = phases.plan(np.zeros(3), [{"phi": 0.3}] * 2, [timed[0].guess(decided={"duration": 0.7}), None])
    assert [p.decided["duration"] for p in plan.phases] == pytest.approx([0.7, 1.6])
    slow = timed[1].guess(u={"a": 0.5}, decided={"duration": 2.5})
    plan = phases.plan(np.zeros(3), [{"phi": 0.3}] * 2, [None, slow])
    assert [p.decided["duration"] for p in plan.phases] == pytest.approx([1.05, 2.5])
    assert plan.phases[1].u[-1, 0] == 0.5
    assert not plan.phases[0].u.any()
    slower = Ode(
        f=lambda x, u, p: swinging(x, u, 0.3),
        states=("phi", "rate", "push"),
        inputs=("a", "fan"),
        params={},
        dt=2.5 / 8,
        substeps=1,
    )
    b = plan.phases[1]
    for i in range(8):
        assert b.x[i + 1] == pytest.approx(np.asarray(slower.step(b.x[i], b.u[i])).ravel(), abs=1e-12)


def test_a_guess_that_leads_nowhere_is_held():
    recorder = Recorder()
    wild = Ode(f=lambda x, u, p: [x[0] ** 3 + u[0]], states=("x",), inputs=("a",), params={}, dt=1.0, substeps=1)
    one = MPC(wild, horizon=6, Q=Weights(x=1.0), R=Weights(a=1.0), limits=Limits(a=100.0))
    plan = Phases([one, one], solver=recorder).plan(
        np.array([3.0]), [{"x": 0.0}] * 2, [one.guess(u={"a": 100.0}), None]
    )
    assert np.isfinite(plan.phases[0].x).all()
    assert np.isfinite(plan.phases[1].x).all()


def test_a_deadline_is_told_and_ends_a_plan():
    recorder = Recorder()
    Phases([first(), first()], solver=recorder, deadline=0.01).plan(np.zeros(2), [{"s": 1.0, "v": 0.0}] * 2)
    assert recorder.deadline == 0.01
    assert 0.0 < recorder.left < 0.01
    soon = Phases([first(), second()], links=[link], deadline=1e-6, solver=RealTime(iterations=0))
    plan = soon.plan(np.array([0.5, 0.1]), [{"s": 1.0, "v": 0.0}, {"phi": 0.3}])
    assert plan.status is Status.TIME_OUT
    assert not plan.status.solved
    with pytest.raises(ParameterError, match="deadline is 0; expected a positive number"):
        Phases([first(), first()], deadline=0)


@pytest.mark.parametrize(
    ("previous", "words"),
    [
        (first().guess(u={"a": 1.0}), "previous is a Guess.*expected a plan of these phases, or a list of 2 guesses"),
        ([None], "previous has 1 guesses; expected one or None for each of 2 phases"),
        ([None, first().guess(u={"a": 1.0})], "the guess is of a problem with the states.*.*guess.*of phase 1"),
        ([first(horizon=5).guess(u={"a": 1.0}), None], "the guess is of another horizon; expected one of 6 stages"),
        ([None, {"x": 1}], "expected a plan of these phases"),
    ],
)
def test_guesses_of_other_problems_are_refused(previous, words):
    phases = Phases([first(), second()], links=[link])
    with pytest.raises(ParameterError, match=words):
        phases.plan(np.zeros(2), [{"s": 0.0, "v": 0.0}, {"phi": 0.0}], previous)
