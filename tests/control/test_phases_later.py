"""Plans of several phases some time after the one before: moved on, over the junction too, and what there is else."""

import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.control.phases import Phases
from slipangle.errors import ParameterError
from slipangle.models.custom import Ode
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from tests.control.test_phases import first, link, second

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler was found")
WANTED = [{"s": 1.0, "v": 0.0}, {"phi": 0.5}]
START = np.array([0.3, 0.2])


@pytest.fixture(scope="module")
def both():
    return Phases([first(), second()], links=[link])


def sliding(low, **settings):
    """Along a line in the shortest time, by the same force in all phases."""
    cart = Ode(f=lambda x, u, p: [x[1], u[0]], states=("s", "v"), inputs=("a",), params={}, dt=0.1)
    given = {"Q": {}, "terminal": Weights(duration=1.0), "R": Weights(a=1e-3), "limits": Limits(a=2.0)}
    return MPC(cart, horizon=8, controls=("a",), duration=(low, 3.0), **(given | settings))


@pytest.fixture(scope="module")
def event():
    """Through a gate, and on to a place beyond it."""
    gate, end = Limits(s=(1.0, 1.0)), Limits(s=(2.0, 2.0), v=(0.0, 0.0))
    return Phases([sliding(0.3, terminal_limits=gate), sliding(0.05, terminal_limits=end)])


def test_phases_of_fixed_length_move_on_to_what_is_found_from_nothing(both):
    x, plan = START, both.plan(START, WANTED, applied=np.array([0.1]))
    for _ in range(4):
        x = np.asarray(both.problems[0].model.step(x, plan.command)).ravel()
        cold = both.plan(x, WANTED, applied=plan.command)
        plan = both.plan(x, WANTED, plan, later=0.1)
        assert plan.status is Status.SOLVED
        assert plan.age == 0
        assert plan.cost == pytest.approx(cold.cost, rel=1e-10)
        for own, other in zip(plan.phases, cold.phases, strict=True):
            assert own.u == pytest.approx(other.u, abs=1e-8)


def test_a_plan_that_is_not_found_is_the_one_before_moved_on(both):
    """Two steps in a row without a state, over a junction from steps of 0.1 s to steps of 0.05 s, then one with."""
    found = both.plan(START, WANTED)
    old, lost = found.phases, found
    for age in (1, 2):
        lost = both.plan(np.full(2, np.nan), WANTED, lost, later=0.1)
        assert lost.status is Status.NOT_FINITE
        assert lost.age == age
        rolls, swings = lost.phases
        assert rolls.u[:-age] == pytest.approx(old[0].u[age:])
        assert rolls.u[-age:] == pytest.approx(np.tile(old[0].u[-1], (age, 1)))
        assert rolls.x[:-age] == pytest.approx(old[0].x[age:])
        step = both.problems[0].model.step
        assert rolls.x[-1] == pytest.approx(np.ravel(step(rolls.x[-2], rolls.u[-1])), abs=1e-12)
        assert swings.u[: -2 * age] == pytest.approx(old[1].u[2 * age :])
        assert swings.x[: -2 * age] == pytest.approx(old[1].x[2 * age :])
        assert swings.times == pytest.approx(old[1].times)
    x = lost.phases[0].x[1]
    again = both.plan(x, WANTED, lost, later=0.1)
    assert again.status is Status.SOLVED
    assert again.age == 0


def test_a_command_of_a_plan_before_keeps_its_rate():
    """From an input applied that was not planned."""
    phases = Phases([first(rates=Limits(a=2.0)), second()], links=[link])
    plan = phases.plan(START, WANTED)
    lost = phases.plan(np.full(2, np.nan), WANTED, plan, later=0.1, applied=np.array([-1.5]))
    assert lost.age == 1
    assert lost.command[0] == pytest.approx(-1.3)


def test_an_event_stays_where_it_was_and_what_is_left_until_then_shrinks(event):
    plan = event.plan(np.zeros(2), [{}, {}])
    whole, rest = (p.decided["duration"] for p in plan.phases)
    lost = event.plan(np.full(2, np.nan), [{}, {}], plan, later=0.11)
    assert lost.age == 1
    assert lost.phases[0].decided["duration"] == pytest.approx(whole - 0.11)
    assert lost.phases[0].times[-1] == pytest.approx(whole - 0.11)
    assert lost.phases[0].x[-1] == pytest.approx(plan.phases[0].x[-1])
    assert lost.phases[1].decided["duration"] == pytest.approx(rest)
    assert lost.phases[1].u == pytest.approx(plan.phases[1].u)
    assert lost.phases[1].x == pytest.approx(plan.phases[1].x)
    assert lost.phases[1].times == pytest.approx(plan.phases[1].times - 0.11)


def test_the_optimum_on_the_way_to_an_event_is_that_from_nothing(event):
    x, plan, h = np.zeros(2), event.plan(np.zeros(2), [{}, {}]), 0.1
    for _ in range(4):
        a = plan.command[0]
        x = np.array([x[0] + h * x[1] + 0.5 * h * h * a, x[1] + h * a])
        cold, plan = event.plan(x, [{}, {}]), event.plan(x, [{}, {}], plan, later=h)
        assert plan.status is Status.SOLVED
        assert plan.cost == pytest.approx(cold.cost, rel=1e-9)
        assert plan.iterations <= cold.iterations


def test_an_event_that_is_due_keeps_the_shortest_duration(event):
    plan = event.plan(np.zeros(2), [{}, {}])
    late = event.plan(np.full(2, np.nan), [{}, {}], plan, later=2.9)
    assert late.phases[0].decided["duration"] == pytest.approx(0.3)
    assert np.isfinite(late.phases[1].x).all()


def test_what_was_no_plan_is_nothing_to_fall_back_to(both):
    lost = both.plan(np.full(2, np.nan), WANTED)
    again = both.plan(np.full(2, np.nan), WANTED, lost, later=0.1)
    assert (lost.age, again.age) == (0, 0)
    assert not again.status.solved
    assert both.plan(START, WANTED, again, later=0.1).status is Status.SOLVED


@pytest.mark.parametrize(("previous", "later"), [(None, 0.1), ([None, None], 0.1), ("own", -0.1), ("own", "0.1")])
def test_a_time_without_a_plan_before_is_refused(both, previous, later):
    if previous == "own":
        previous = both.plan(START, WANTED)
    with pytest.raises(ParameterError, match="later is"):
        both.plan(START, WANTED, previous, later=later)


def test_a_plan_of_other_phases_is_refused(both, event):
    with pytest.raises(ParameterError, match="of these phases"):
        both.plan(START, WANTED, event.plan(np.zeros(2), [{}, {}]), later=0.1)
