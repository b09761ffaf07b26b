"""What a problem is given and nothing reads is refused when it is posed, not planned without."""

from typing import Any

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ParameterError
from slipangle.ops import where


def posed(**settings: Any) -> sa.MPC:
    model = sa.Ode(
        f=lambda x, u, p: [x[1], u[0] / p.mass],
        states=("s", "speed"),
        inputs=("a",),
        params={"mass": 1.0, "idle": 2.0},
        dt=0.1,
    )
    given: dict[str, Any] = {"horizon": 5, "Q": {"s": 1.0}, "R": {"a": 0.1}, "limits": {"a": 2.0}, **settings}
    return sa.MPC(model, **given)


TERM = {"gap": lambda x, u, p: x[0] - p.ahead}
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "no term": (
        {"parameters": ("ahead",)},
        "parameters name 'ahead', which no term reads; expected p.ahead in one of terms, of which there are none",
    ),
    "another": (
        {"parameters": ("ahead", "behind"), "terms": TERM, "Q": {"gap": 1.0}},
        "parameters name 'behind', which no term reads; expected p.behind in one of ['gap']",
    ),
    "free": (
        {"parameters": ("ahead",), "free": {"ahead": 1.0}},
        "parameters name 'ahead', which no term reads",
    ),
    "of the model": ({"free": {"idle": (1.0, 3.0)}}, "free names 'idle', on which neither the model's equations nor"),
    "scenarios": ({"scenarios": sa.Scenarios({"idle": (1.0, 3.0)})}, "scenarios name 'idle', on which neither"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_parameter_that_nothing_reads_is_refused(name):
    settings, said = REFUSED[name]
    with pytest.raises(ParameterError) as error:
        posed(**settings)
    assert str(error.value).startswith(said)


READ: dict[str, dict[str, Any]] = {
    "term": {"parameters": ("ahead",), "terms": TERM, "Q": {"gap": 1.0}},
    "comparison": {
        "parameters": ("ahead",),
        "terms": {"past": lambda x, u, p: where(x[0] > p.ahead, x[0], 0.0)},
        "Q": {"past": 1.0},
    },
    "free": {"parameters": ("ahead",), "free": {"ahead": 1.0}, "terms": TERM, "Q": {"gap": 1.0}},
    "tracked alone": {"free": {"idle": (1.0, 3.0)}, "Q": {"s": 1.0, "idle": 1.0}},
    "equations": {"free": {"mass": (1.0, 3.0)}},
    "scenarios": {"scenarios": sa.Scenarios({"mass": (1.0, 3.0)})},
    "model's in a term": {
        "free": {"idle": (1.0, 3.0)},
        "terms": {"pull": lambda x, u, p: x[0] - p.idle},
        "Q": {"pull": 1.0},
    },
}


@pytest.mark.parametrize("name", READ)
def test_a_parameter_that_is_read_anywhere_is_taken(name):
    settings = READ[name]
    wanted = {n: 0.5 for n in settings.get("parameters", ()) if n not in settings.get("free", {})}
    with np.errstate(all="raise"):
        assert posed(**settings).setpoint(**wanted).exogenous.shape[0] == 6


def test_a_wanted_input_without_a_weight_is_refused():
    mpc = posed(R={}, S={"a": 0.1})
    with pytest.raises(ParameterError, match="names the input 'a', which has no weight in R"):
        mpc.setpoint(a=0.3)
    assert posed().setpoint(a=0.3).inputs is not None


@pytest.mark.parametrize("free", [{"slack": {"speed": 0.0}}, {"slack": {"speed": 0.0}, "slack_linear": {"speed": 0.0}}])
def test_a_soft_limit_at_no_price_is_refused(free):
    limits = {"a": 2.0, "speed": 0.1}
    with pytest.raises(ParameterError, match="the limit of 'speed' is soft at no price"):
        posed(limits=limits, **free)
    for priced in ({"slack": {"speed": 0.0}, "slack_linear": {"speed": 9.0}}, {}):
        plan = posed(limits=limits, **priced).plan(np.zeros(2), s=1.0)
        assert plan.x[:, 1].max() == pytest.approx(0.1, abs=1e-9)
