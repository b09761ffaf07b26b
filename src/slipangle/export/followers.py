"""C of the path followers: each law once more, its parameters as constants."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

from slipangle.control.followers.compensated import Compensated
from slipangle.control.followers.feedforward import LONGEST, SHORTEST, SLOWEST, FeedforwardFeedback
from slipangle.control.followers.followers import PathFollower, PurePursuit, Stanley
from slipangle.control.followers.preview_lqr import PreviewLQR
from slipangle.errors import ParameterError
from slipangle.export.controllers import around, number, project, table
from slipangle.export.drives import Drive
from slipangle.export.models import sourced, step_function
from slipangle.export.project import Project, template


@singledispatch
def law(follower: Any) -> tuple[str, str, dict[str, Any], dict[str, Any]]:
    """Name of a steering law, its file, its numbers and its arrays; others register theirs.

    Raises ParameterError if there is no C of it.
    """
    raise ParameterError(f"a {type(follower).__name__} has no law; expected a path follower")


@law.register
def _(follower: PurePursuit) -> tuple[str, str, dict[str, Any], dict[str, Any]]:
    p = follower.params
    numbers = {"REAR": p.l_r, "WHEELBASE": p.wheelbase, "LOOK_AHEAD": follower.gain, "SHORTEST": follower.shortest}
    return "pure pursuit", "pure_pursuit.c", numbers, {}


@law.register
def _(follower: Stanley) -> tuple[str, str, dict[str, Any], dict[str, Any]]:
    numbers = {"PULL": follower.gain, "SOFTENING": follower.softening, "DAMPING": follower.damping}
    return "Stanley controller", "stanley.c", {"FRONT": follower.params.l_f, **numbers}, {}


@law.register
def _(follower: PreviewLQR) -> tuple[str, str, dict[str, Any], dict[str, Any]]:
    feedback, ahead = follower.gains
    numbers = {"FRONT": follower.params.l_f, "SLIP": follower.slip}
    return (
        "LQR with preview",
        "preview_lqr.c",
        numbers,
        {"SPEEDS": follower.speeds, "FEEDBACK": feedback, "AHEAD": ahead},
    )


@law.register
def _(follower: FeedforwardFeedback) -> tuple[str, str, dict[str, Any], dict[str, Any]]:
    p = follower.params
    numbers = {"REAR": p.l_r, "WHEELBASE": p.wheelbase, "UNDERSTEER": follower.understeer_gradient}
    numbers |= {"SLIPPING": p.mass * p.l_f / (p.wheelbase * p.C_r)}  # side slip of a bend, per curvature and v^2
    numbers |= {"DAMPED": (p.C_f + p.C_r) / p.mass + (p.C_f * p.l_f**2 + p.C_r * p.l_r**2) / p.inertia_z}
    numbers |= {"COUPLED": p.C_f * p.C_r * p.wheelbase**2 / (p.mass * p.inertia_z)}
    numbers |= {"TURNING": (p.C_r * p.l_r - p.C_f * p.l_f) / p.inertia_z}
    numbers |= {"LEAD": follower.lead, "BANDWIDTH": follower.bandwidth, "DAMPING": follower.damping}
    numbers |= {"SLOWEST": SLOWEST, "LONGEST": LONGEST, "SHORTEST": SHORTEST}
    return "feed-forward and feedback law", "feedforward.c", numbers, {"TIMES": follower.times}


def follower_project(follower: PathFollower | Compensated, name: str, drive: Drive) -> Project:
    """The files of a path follower; name and drive as for `project`.

    Raises ParameterError if there is no C of its law.
    """
    inner = follower.follower if isinstance(follower, Compensated) else follower
    writer = next(k for k in type(inner).__mro__ if "law" in vars(k))  # of the law, which a subclass may change
    if writer not in law.registry:
        raise ParameterError(
            f"a {type(inner).__name__} has a law of its own, which has no C; expected PurePursuit, Stanley, "
            "PreviewLQR or FeedforwardFeedback: register it with slipangle.export.followers.law"
        )
    kind, file, numbers, arrays = law.dispatch(writer)(inner)
    low, high = follower._judge.ranges
    steering = {"GAIN": inner.params.steering_gain, "OFFSET": inner.params.steering_offset}
    if isinstance(follower, Compensated):
        numbers |= {f"LAW_{n}": v for n, v in steering.items()}
        steering = {"GAIN": 1.0, "OFFSET": 0.0}
    numbers |= steering
    numbers |= {"LIMIT": follower.limit, "MOST": follower.rate * follower.dt, "WHOLE_TURN": 6.283185307179586}
    arrays |= {"LOWEST": low, "HIGHEST": high}
    lines = ["#include <math.h>", "#include <string.h>", *(table(n, v) for n, v in arrays.items())]
    lines += [f"#define {n} {number(v)}" for n, v in numbers.items()]
    lines += [f"#define N_SPEEDS {len(arrays['SPEEDS'])}"] if "SPEEDS" in arrays else []
    if isinstance(follower, Compensated):
        kind = f"{kind} with delay and steady error compensated,"
        asked = template(file).replace("CAR_NODES", "LAW_NODES").replace("double steer(", "double follow(")
        text = "\n".join([*lines, *_car(follower), asked, around(template("compensated.c"), template("follower.c"))])
    else:
        text = "\n".join([*lines, around(template(file), template("follower.c"))])
    return project(follower, name, drive, text, kind=kind, facts={"horizon": follower.horizon})


def _car(follower: Compensated) -> list[str]:
    """The car that a `Compensated` knows: its step, its steady driving, and what of its state the law sees."""
    model, steady, states = follower.model, follower._steady, follower.follower.model.states
    speeds, _ = steady.table
    known = ("X", "Y", "psi", "v_y", "r")
    sizes = {"LEAD_STEPS": follower.lead, "LAW_STATES": len(states), "MODEL_INPUTS": model.n_inputs}
    sizes |= {"LAW_NODES": follower.follower.horizon + 1, "STEERING": model.inputs.index("delta")}
    sizes |= {"N_STEADY": len(speeds), "N_TERMS": 2 + len(steady.disturbances)}
    lines = [*(f"#define {n} {v}" for n, v in sizes.items()), f"#define STEP {number(follower.dt)}"]
    lines += [table("STEADY_SPEEDS", speeds), table("STEADY", steady._table)]
    lines += [
        table("PUSHES", steady.disturbances, "int"),
        table("SEEN", [model.states.index(n) for n in states], "int"),
    ]
    lines += [table("TARGET", [known.index(n) for n in states], "int")]
    given = ["x[CAR_STATES]", "u[MODEL_INPUTS]"]
    return [*lines, sourced([("static void model_step", step_function(model), given, "next[CAR_STATES]")])]
