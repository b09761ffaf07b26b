"""`linearize`: any model around a steady state, as a `LinearisedModel`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from slipangle.errors import ModelWarning, ParameterError, nearest
from slipangle.models.analysis.linearised import SHARE, LinearisedModel
from slipangle.models.analysis.trim import STEERING, Motion, Trim, moving
from slipangle.models.model import Model
from slipangle.numerics.critical import quantile


def linearize(
    model: Model,
    *,
    v_x: float | None = None,
    a_y: float = 0.0,
    inputs: Mapping[str, float] | None = None,
    outputs: Sequence[str] = (),
    hold_speed: bool | None = None,
    name: str = "",
) -> LinearisedModel:
    """A model around a steady state, as a linear state space with confidence bands.

    The steady state has the speed ``v_x`` and the lateral acceleration ``a_y``; steering and driving inputs that keep
    it are found. Where the model is no more than an ODE, the result is in continuous time, else sampled as the model
    is, or what it is the samples of: a `ProcessModel` or `TransferFunction` was fitted in continuous time, with its
    delay. Position and heading are left out. Bands are those of the fit's intervals and correlations, to first order
    (delta method).

    Raises ParameterError where there is no such steady state, or a name is not the model's; warns with ModelWarning
    where the model has a kink there.

    Parameters
    ----------
    model : Model
        Any; a linear black box gives its own matrices.
    v_x : float
        Speed; needed where the model has one. [m/s]
    a_y : float
        Lateral acceleration ``v_x r``, positive in a left turn. [m/s2]
    inputs : mapping, optional
        Values of inputs that are not to be searched, such as ``{"bank": 0.02}``; others than steering and driving ones
        are 0. SI units.
    outputs : sequence of str, optional
        By default the model's; its states can be asked for too, and "beta" and "a_y" where v_y and r are states.
    hold_speed : bool, optional
        Whether the speed is kept instead of a state, as standards for lateral dynamics have it; by default where the
        model steers.
    name : str, optional
        For figures; by default the model's class.

    For example ``sa.linearize(bicycle, v_x=20.0).bode("r", "delta").plot()``.
    """
    model = model.off_ground
    info = model.fit_info
    adjustable = getattr(model, "parameter_names", ())
    names = tuple(n for n in info.names if n in adjustable) if info is not None else ()
    motion = Motion(model, names)
    trim = motion.trim(v_x, a_y, inputs or {}, motion.values)
    hold = any(n in model.inputs for n in STEERING) if hold_speed is None else hold_speed
    kept = [i for i, s in enumerate(model.states) if s not in moving(model)]
    if hold and {model.states[i] for i in kept} > {"v_x"}:
        kept = [i for i in kept if model.states[i] != "v_x"]
    chosen = tuple(outputs) or tuple(n for n in model.outputs if n not in moving(model))
    if not chosen:
        chosen = tuple(model.states[i] for i in kept)

    if model.continuous is not None:
        return _fitted_in_continuous_time(model, trim, chosen, name)

    def at(place: Trim, p: np.ndarray) -> LinearisedModel:
        return _assembled(motion, place, motion.slopes(place.x, place.u, p), kept, chosen, name)

    found = at(trim, motion.values)
    bent = motion.kinks(trim, motion.values)
    if bent:
        warnings.warn(
            f"the {found.name} is not smooth in {', '.join(bent[:4])} at this steady state, so no one linear model "
            "holds on both sides; expected a smooth one: take a small a_y or another speed",
            ModelWarning,
            stacklevel=2,
        )
    if not names:
        said, others = neighbours(model)

        def of(other: Model) -> LinearisedModel:
            if model.affine:
                return _assembled(motion, trim, _matrices(other), kept, chosen, name)
            moved = Motion(other)
            place = moved.trim(v_x, a_y, inputs or {}, moved.values, near=trim)
            return _assembled(moved, place, moved.slopes(place.x, place.u, moved.values), kept, chosen, name)

        pairs = [[of(m) for m in pair] for pair in others]
        return replace(found, variants=tuple((a, b) for a, b in pairs), uncertainty=said)
    said, roots = directions(model, names)
    pairs = []
    for d in roots:
        ends = [motion.values + sign * SHARE * d for sign in (1, -1)]
        pairs.append([at(motion.trim(v_x, a_y, inputs or {}, p, near=trim), p) for p in ends])
    return replace(found, variants=tuple((a, b) for a, b in pairs), uncertainty=said)


def _assembled(
    motion: Motion,
    place: Trim,
    slopes: tuple[np.ndarray, ...],
    kept: Sequence[int],
    chosen: tuple[str, ...],
    name: str,
) -> LinearisedModel:
    """The linear state space of the states that are kept, from what `Motion.slopes` gives."""
    model = motion.model
    _, by_x, by_u, _, seen_x, seen_u = slopes
    rows = [_row(n, motion, place, by_x, by_u, seen_x, seen_u) for n in chosen]
    C, D = np.array([r[0] for r in rows])[:, kept], np.array([r[1] for r in rows])
    states = tuple(model.states[i] for i in kept)
    named: dict[str, Any] = {"states": states, "inputs": model.inputs, "outputs": chosen}
    matrices: dict[str, Any] = {"A": by_x[np.ix_(kept, kept)], "B": by_u[kept], "C": C, "D": D}
    return LinearisedModel(**matrices, dt=motion.dt, trim=place, name=name or type(model).__name__, **named)


def neighbours(model: Model) -> tuple[str, list[tuple[Model, Model]]]:
    """A sentence, and models to both sides along each direction in which the coefficients of a fit are unsure."""
    info = model.fit_info
    if info is None or not (len(info.values) and model.with_estimates(info.values)):
        return directions(model, ())[0], []
    said, roots = directions(model, info.names)
    pairs = []
    for d in roots:
        up, down = (model.with_estimates(info.values + sign * SHARE * d) for sign in (1, -1))
        pairs += [(up, down)] if np.any(d) and up is not None and down is not None else []
    return said, pairs


def _matrices(model: Model) -> tuple[np.ndarray, ...]:
    """What `Motion.slopes` gives, of a model that is affine: by unit states and inputs."""
    x, u = np.zeros(model.n_states), np.zeros(model.n_inputs)
    found = []
    for of in (model.step, model.output):
        first = np.asarray(of(x, u), dtype=float)
        by_x = [np.asarray(of(row, u), dtype=float) - first for row in np.eye(len(x))]
        by_u = [np.asarray(of(x, row), dtype=float) - first for row in np.eye(len(u))]
        found += [first, *(np.array(v).T.reshape(len(first), -1) for v in (by_x, by_u))]
    return tuple(found)


def _fitted_in_continuous_time(model: Model, trim: Trim, chosen: tuple[str, ...], name: str) -> LinearisedModel:
    """The system that a model is the samples of, one input to one output."""
    if chosen != model.outputs:
        raise ParameterError(
            f"outputs are {', '.join(chosen)}; expected {model.outputs[0]} alone of the {type(model).__name__}: "
            "leave them out"
        )

    def of(one: Model) -> LinearisedModel:
        F, G, H, delay = cast(tuple[np.ndarray, np.ndarray, np.ndarray, float], one.continuous)
        matrices: dict[str, Any] = {"A": F, "B": G[:, None], "C": H[None], "D": np.zeros((1, 1))}
        named: dict[str, Any] = {"states": one.states[: len(F)], "inputs": one.inputs, "outputs": one.outputs}
        named["name"] = name or type(model).__name__
        return LinearisedModel(**matrices, **named, dt=0.0, delay=np.array([delay]), trim=trim)

    said, others = neighbours(model)
    return replace(of(model), variants=tuple((of(a), of(b)) for a, b in others), uncertainty=said)


def directions(model: Model, names: tuple[str, ...]) -> tuple[str, np.ndarray]:
    """A sentence, and columns of a root of the covariance of the named parameters as rows, shape (n, n)."""
    info = model.fit_info
    if info is None:
        return "no bands: it is no fit", np.zeros((0, 0))
    if not names:
        return f"no bands: none of {len(info.names)} estimates can be varied by name", np.zeros((0, 0))
    rows = [info.names.index(n) for n in names]
    std = np.ptp(info.interval(), axis=1)[rows] / (2 * quantile(0.95))  # an interval may be wider than the covariance
    if not (np.isfinite(info.covariance[np.ix_(rows, rows)]).all() and np.isfinite(std).all()):
        return "no bands: the covariance of the fit is not finite", np.zeros((0, 0))
    correlation = info.correlation[np.ix_(rows, rows)]  # free of units: small variances are no rounding of large ones
    size, vector = np.linalg.eigh((correlation + correlation.T) / 2)
    shown = ", ".join(names[:6]) + (" and others" if len(names) > 6 else "")
    root = std[:, None] * vector * np.sqrt(np.maximum(size, 0.0))
    return f"{quantile(0.95):.3g} standard deviations of {shown}", root.T


def _row(
    name: str,
    motion: Motion,
    trim: Trim,
    by_x: np.ndarray,
    by_u: np.ndarray,
    seen_x: np.ndarray,
    seen_u: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of one output by states and inputs."""
    model = motion.model
    if name in model.outputs:
        i = model.outputs.index(name)
        return seen_x[i], seen_u[i]
    n, nu = model.n_states, model.n_inputs
    if name in model.states:
        return np.eye(n)[model.states.index(name)], np.zeros(nu)
    v_x = trim.v_x
    lateral = {"v_y", "r"} <= {*model.states}
    if lateral and v_x is not None and name == "beta":
        v_y = float(trim.x[model.states.index("v_y")])
        return np.eye(n)[model.states.index("v_y")] * v_x / (v_x**2 + v_y**2), np.zeros(nu)
    if lateral and v_x is not None and name == "a_y" and not motion.dt:
        i, j = model.states.index("v_y"), model.states.index("r")
        row, direct = by_x[i] + v_x * np.eye(n)[j], by_u[i].copy()
        if "v_x" in model.inputs:
            direct[model.inputs.index("v_x")] += trim.x[j]
        return row, direct
    known = [*model.outputs, *model.states, *(["beta", "a_y"] if lateral else [])]
    raise ParameterError(f"the {type(model).__name__} has no output or state '{name}'; {nearest(name, known)}")
