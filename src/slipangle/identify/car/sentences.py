"""What there is to know of an identified car, in words: what corrections changed, and what the log cannot say."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from slipangle.data.recordings import recordings
from slipangle.identify.car.corrections import LOADS, SPEED, friction_used
from slipangle.identify.car.effects import WEIGHT, explained
from slipangle.identify.car.left_over import HOLD, NO_HOLD
from slipangle.identify.car.stretches import Stretches
from slipangle.identify.car.structures import ELSEWHERE, STIFF, Fitted, Others, Stage, settling, worth
from slipangle.identify.car.uncertainty import hull_of_sum
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.ops import Scalar

_HALF = 0.5  # share from which a structure is told of
_NOTHING = 1e-3  # of the upper limit, up to which the lower one is none
_APART = 0.015, 0.25  # half width of delay and lag from which they are not told apart: s, and share of their sum
_WIDE = 0.25  # half of an interval over the value, from which a parameter counts as not separated
_MOVED = 0.05  # change of a parameter that is worth a sentence
_GAIN = (0.75, 1.33)  # of the steering, found over given, that needs no word
_MOMENT = (0.9, 1.11)  # of what a logged yaw moment, or rear wheels, do over what they say, that needs no word
_BEYOND = 1.2  # friction found over friction used, from which a limit is extrapolated
_SHOWN = 6  # values of single recordings that a sentence lists
_STIFFEST = (3.0, 60.0)  # cornering stiffness over the axle's load, of any tire [1/rad]
_HEAVIEST = (0.25, 2.5)  # yaw inertia over mass l_f l_r, of any car [-]
_BELOW = 0.8  # friction found over friction used, up to which the car could not have driven so
_LEFT_OUT = 0.4  # share of the driving from which it is said that it was not used
_SOUND = {"lever_v_y": 0.0, "gain_v_y": 1.0, "turn_v_y": 0.0}  # a v_y sensor that reads what there is
_DEAF = 0.1  # share of the outputs' variance up to which nothing is explained


def separated(names: tuple[str, ...], final: Fitted, limits: np.ndarray) -> dict[str, bool]:
    """Whether C_f, C_r and inertia_z have values of their own; ``limits`` has shape (n_names, 2)."""
    return {name: bool(np.ptp(limits[names.index(name)]) / 2 < _WIDE * abs(final.values[name])) for name in STIFF}


def left_out(whole: Stretches) -> list[str]:
    """When the car span, and how much of the driving was left out where that is much."""
    said, unused = [], whole.unused
    if whole.spins:
        when = ", ".join(f"{a:.3g} to {b:.3g}" for a, b in whole.spins[:_SHOWN])
        more = f" and {len(whole.spins) - _SHOWN} more times" if len(whole.spins) > _SHOWN else ""
        said.append(f"the car spins at {when} s{more}: that is left out, as no tire curve is told from it")
    if unused >= _LEFT_OUT:
        said.append(
            f"{100 * unused:.0f} % of the driving is in pieces too short to use, between gaps and halts; expected most "
            'of it whole: close gaps of single samples (nan = "merge" joins columns by time), or record without'
        )
    return said


def changes(stages: list[Stage]) -> list[str]:
    """What each correction that was kept did to the held-out error and to the parameters."""
    said, before = [], stages[0].values
    for stage in stages[1:]:
        moved = [
            f"{name} {short(before[name])} -> {short(stage.values[name])}"
            for name in (*STIFF, "steering_gain")
            if name in before and abs(stage.values[name] / before[name] - 1) > _MOVED
        ]
        share = 100 * (np.exp(stage.change / 2) - 1)
        if stage.kept:
            less = f"the held-out error {'falls' if share < 0 else 'rises'} by {abs(share):.2g} %"
            said.append(f"{less} when {stage.correction}" + (f": {', '.join(moved)}" if moved else ""))
            before = stage.values
    return said


def steering(final: Fitted, others: Others, limits: np.ndarray) -> list[str]:
    """How late the road wheels are, and how much of it is pure delay and how much lag; limits have shape (n_names, 2).

    Their sum has the range of the structures as good: what tires take to build up their force may be in it.
    """
    names: tuple[str, ...] = final.names
    pair, limit = ("delay_delta", "steering_lag"), fastest(names, final, limits)
    if "delay_delta" in final.own:
        return limit
    if not {*pair} <= {*names}:
        return ["no delay and no lag of the steering shows: the log is explained as well without"]
    at = [names.index(name) for name in pair]
    late = 1000 * sum(final.values[name] for name in pair)
    soonest, latest = 1000 * np.maximum(hull_of_sum(pair, final, others), 0.0)
    delay, lag = (
        f"{1000 * final.values[n]:.0f} ({1000 * limits[i, 0]:.0f} to {1000 * limits[i, 1]:.0f}) ms"
        for n, i in zip(pair, at, strict=True)
    )
    least, share = _APART
    what = "the road wheels are" if "relaxation_f" in final.free else "steering and tires together are"
    whole = f"{what} {late:.0f} ({np.floor(soonest):.0f} to {np.ceil(latest):.0f}) ms late"
    if np.ptp(limits[at], axis=1).max() / 2 < max(least, share * late / 1000):
        return [f"{whole}: pure delay {delay}, first-order lag {lag}", *limit]
    return [
        f"{whole}; how much of it is pure delay, {delay}, and how much lag, {lag}, cannot be separated: steer faster, "
        f"log at more than {1 / final.model.dt:.3g} Hz",
        *limit,
    ]


def fastest(names: tuple[str, ...], final: Fitted, limits: np.ndarray) -> list[str]:
    """The largest rate of the steering, where the log shows one; ``limits`` has shape (n_names, 2)."""
    if "steering_rate" not in names:
        return []
    low, high = limits[names.index("steering_rate")]
    return [
        f"the steering turns no faster than {final.values['steering_rate']:.3g} ({low:.3g} to {high:.3g}) rad/s of "
        "what delta asks"
    ]


def ridges(
    names: tuple[str, ...], final: Fitted, spread: np.ndarray, limits: np.ndarray, separated: Mapping[str, bool]
) -> list[str]:
    """Parameters that the log cannot tell, and ratios of them that it can; ``spread`` is their covariance."""
    said = []
    poor = [name for name, fine in separated.items() if not fine]
    more = "drive faster steering" if "v_y" in final.model.outputs else "measure v_y, or drive faster steering"
    for name in poor:
        (low, high), si = limits[names.index(name)], final.model.si(name)
        span = f"{short(low)} to {short(high)} {si.unit} explain" if low > _NOTHING * high else ""
        span = span or f"anything up to {short(high)} {si.unit} explains"
        said.append(
            f"{name} cannot be separated: {span} the log alike; expected less than a quarter either way: {more}"
        )
    for i, a in enumerate(poor):
        for b in poor[i + 1 :]:
            width = _ratio(names, final, spread, a, b)
            if width < 0.5 * _WIDE:
                ratio = final.values[a] / final.values[b]
                said.append(f"their ratio is known: {a} / {b} = {ratio:.3g} +- {100 * width:.2g} % (95 %)")
    return said


def _ratio(names: tuple[str, ...], final: Fitted, spread: np.ndarray, a: str, b: str) -> Scalar:
    """Half width of the 95 % interval of a / b, relative."""
    at = [names.index(a), names.index(b)]
    values = np.array([final.values[a], final.values[b]])
    relative = spread[np.ix_(at, at)] / np.outer(values, values)
    return 1.96 * float(np.sqrt(max(relative[0, 0] + relative[1, 1] - 2 * relative[0, 1], 0.0)))


def held(said: list[str], *, doubted: bool) -> list[str]:
    """Sentences that promise no interval where the car is doubted for another reason than theirs."""
    return [sentence.replace(HOLD, NO_HOLD) if doubted else sentence for sentence in said]


def turning(final: Fitted, first: float) -> list[str]:
    """A steering's gain far from ``first``, which was given."""
    gain = final.values.get("steering_gain", first) / first
    if _GAIN[0] < gain < _GAIN[1]:
        return []
    alone = {"v_y", "a_y"}.isdisjoint(final.model.outputs)  # then no locked axle is told from such a gain
    solid = "; rear wheels that turn as one, as of a kart, look so too" if alone and 0 < gain < 1 else ""
    return [
        f"the road wheels turn {gain:.2g} times what delta says; expected about as much: check the wheelbase, the "
        f"steering ratio and the units{solid}"
    ]


def acting(names: tuple[str, ...], final: Fitted, limits: np.ndarray) -> str:
    """How a yaw moment acts that was logged, over what it says, with ``limits`` of shape (n_names, 2); "" of none."""
    if "gain_M_z" not in names:
        return ""
    (low, high), (soon, late) = limits[names.index("gain_M_z")], 1000 * limits[names.index("delay_M_z")]
    return (
        f"{final.values['gain_M_z']:.2g} ({low:.2g} to {high:.2g}) times the moment that was logged, "
        f"{1000 * final.values['delay_M_z']:.0f} ({soon:.0f} to {late:.0f}) ms later"
    )


def moment(names: tuple[str, ...], final: Fitted, limits: np.ndarray) -> list[str]:
    """A logged yaw moment that acts otherwise than it says; ``limits`` has shape (n_names, 2)."""
    found = acting(names, final, limits)
    low, high = limits[names.index("gain_M_z")] if found else (1.0, 1.0)
    if low <= _MOMENT[1] and high >= _MOMENT[0]:
        return []
    return [
        f"M_z turns the car as {found}, at the mass that was given; expected about as much: check its sign, unit and "
        "scale, and the mass"
    ]


def rear(names: tuple[str, ...], final: Fitted, limits: np.ndarray) -> list[str]:
    """Rear wheels that turn otherwise than was logged; ``limits`` has shape (n_names, 2)."""
    low, high = limits[names.index("gain_delta_r")] if "gain_delta_r" in names else (1.0, 1.0)
    if low <= _MOMENT[1] and high >= _MOMENT[0]:
        return []
    return [
        f"the rear wheels turn {final.values['gain_delta_r']:.3g} ({low:.3g} to {high:.3g}) times what delta_r says; "
        "expected about as much: check its sign, unit and scale"
    ]


def impossible(names: tuple[str, ...], final: Fitted, limits: np.ndarray, used: float) -> list[str]:
    """Values that no car has, wherever in their intervals, shape (n_names, 2), they lie; a log that tells nothing.

    A yaw moment or rear wheels that act otherwise than they were logged are among them, see `moment` and `rear`.

    ``used`` is the friction that the log reached. [-]
    """
    p, said = final.model.ode.params, [*moment(names, final, limits), *rear(names, final, limits)]
    load = GRAVITY * p.mass / p.wheelbase
    for name, unit, words, (least, most) in (
        ("C_f", load * p.l_r, "the front axle's load per radian", _STIFFEST),
        ("C_r", load * p.l_f, "the rear axle's load per radian", _STIFFEST),
        ("inertia_z", p.mass * p.l_f * p.l_r, "mass l_f l_r", _HEAVIEST),
    ):
        low, high = limits[names.index(name)] / unit
        if high < least or low > most:
            said.append(
                f"{name} is {final.values[name] / unit:.2g} times {words}; expected {least:g} to {most:g}: check l_f, "
                "and the signs and units of all channels"
            )
    for name in (n for n in ("mu_f", "mu_r") if n in names):
        if final.values[name] < _BELOW * used and limits[names.index(name)][1] < used:
            said.append(
                f"{name} is {final.values[name]:.2g}, and the lateral acceleration that v_x and r tell asks for "
                f"{used:.2g}; expected at least as much friction: check v_x and r, and do not drive near the "
                "limit by this model"
            )
    return [*said, *_unexplained(final)]


def _unexplained(final: Fitted) -> list[str]:
    """Outputs that have nothing to do with steering and speed: all of them, or some, which then spoil the others."""
    told = explained(final)
    shares = [f"{100 * max(share, 0.0):.0f} % of {n}" for n, share in zip(final.model.outputs, told, strict=True)]
    lost, heard = (
        [s for s, share in zip(shares, told, strict=True) if (share < _DEAF) == deaf] for deaf in (True, False)
    )
    if not lost:
        return []
    said = f"steering and speed explain {' and '.join(lost)}"
    if heard:
        return [
            f"{said}, but {' and '.join(heard)}, on the log of the fit itself; expected most of each: check that its "
            "column is the right one, with its sign, of this drive and clock, and more than noise"
        ]
    asked = "check that the columns are the right ones, of one drive and one clock, and that the car is steered"
    return [f"{said}, on the log of the fit itself; expected most of it: {asked}"]


def friction_reached(final: Fitted) -> float:
    """Largest lateral acceleration of the log over that of gravity and downforce, but for outliers.

    It is ``v_x r`` as measured and the rate of v_y in a free run: in a quick swerve ``v_x r`` alone may be half as much
    again as what the tires hold.
    """
    found, data, models = [], final.problem.data, dict[int, Any]()
    for part, recording in zip(data.experiments, recordings(data), strict=True):
        if recording not in models:  # whose functions are built once
            models[recording] = final.model_of(recording).with_values(**_SOUND).resampled(part.dt, outputs=("v_y",))
        model = models[recording]
        first = model.memory - 1
        inputs = part.select(inputs=model.inputs).u[first:]
        run = model.free_run(model.initial_state(part.rows(0, model.memory)), inputs)[:, 0]
        turn, load = part["v_x"] * part["r"], model.ode.params.load_ratio(part["v_x"][first + 1 :])
        found.append(((turn[first + 1 :] + np.gradient(run, part.dt)) / load)[settling(len(run), part.dt) :])
    sideways = np.abs(np.concatenate(found))
    alone = friction_used(data, final.model.ode.params)
    return min(float(np.quantile(sideways, 0.999)) / GRAVITY, alone) if np.isfinite(sideways).all() else alone


def between(final: Fitted) -> list[str]:
    """What differs between the recordings, and what that means for another one."""
    said = []
    for name in final.own:
        each = ", ".join(f"{final.values[f'{name}[{k}]']:.3g}" for k in final.problem.recordings[:_SHOWN])
        more = f" and {len(final.problem.recordings) - _SHOWN} more" if len(final.problem.recordings) > _SHOWN else ""
        first = "that of the first" if name == "mass" else "their mean"
        said.append(
            f"{name} differs between the recordings: {each}{more} {final.model.si(name).unit}; the model has {first}, "
            "another recording has one of its own: read it from its first seconds, by identified.for_recording(log) or "
            "a job's opening"
        )
    return said


def elsewhere(final: Fitted, others: Others) -> list[str]:
    """A v_y sensor away from the centre of gravity beside a centre of gravity elsewhere that does the same."""
    return [
        f"a v_y sensor {final.values['lever_v_y']:+.2g} m from the centre of gravity explains the log, and so does l_f "
        f"= {other.values['l_f']:.3g} m in place of {final.model.ode.params.l_f:.3g} m: check both; the intervals hold "
        f"for either, but not for a third explanation, {_of_another_length(final)}"
        for other, share in others
        if {"lever_v_y", "l_f"} <= {*other.free} and share > _HALF
    ][:1]


def misplaced(final: Fitted, others: Others, limits: np.ndarray) -> list[str]:
    """A v_y sensor so far from the centre of gravity that no interval holds if it is elsewhere."""
    if "lever_v_y" not in final.free or elsewhere(final, others):
        return []
    p, lever, at = final.model.ode.params, final.values["lever_v_y"], limits[final.names.index("lever_v_y")]
    l_f = p.l_f - lever  # where the centre of gravity is if the sensor sits there
    if abs(lever) < ELSEWHERE * p.wheelbase or at[0] * at[1] <= 0 or not 0 < l_f < p.wheelbase:
        return []
    if not WEIGHT[0] < l_f / p.wheelbase < WEIGHT[1]:
        return [
            f"v_y reads as if measured {lever:+.2g} m from the centre of gravity, which no place of that explains: l_f "
            f"would be {l_f:.3g} m of {p.wheelbase:.3g} m; if its sensor is not there, v_y is in another unit, such as "
            "km/h, and no interval holds: check both"
        ]
    C_f, C_r = (final.values[n] * share for n, share in (("C_f", (p.wheelbase - l_f) / p.l_r), ("C_r", l_f / p.l_f)))
    return [
        f"v_y reads as if measured {lever:+.2g} m from the centre of gravity: if its sensor sits there, l_f is "
        f"{l_f:.3g} m in place of {p.l_f:.3g} m, C_f about {short(C_f)} and C_r {short(C_r)} N/rad, and the intervals "
        f"do not hold; as well it may be {_of_another_length(final)}: check both places and the wheelbase"
    ]


def _of_another_length(final: Fitted) -> str:
    """The car of another wheelbase, its axles in proportion, whose v_y at the centre of gravity is the one logged.

    Its rear axle lies where the log has it, so that slip angles, forces and stiffness stay nearly as they are; its
    yaw inertia goes with the square of its lever arms, its steering with the wheelbase.
    """
    p, values = final.model.ode.params, final.values
    share = (p.l_r + values["lever_v_y"]) / p.l_r
    gain, inertia = final.model.value("steering_gain"), short(share**2 * values["inertia_z"])
    return (
        f"a wheelbase of about {share * p.wheelbase:.3g} m in place of {p.wheelbase:.3g} m, l_f in proportion, with "
        f"wheels that turn {share * gain:.2g} times what delta says and inertia_z about {inertia}"
    )


def speed(final: Fitted, others: Others) -> list[str]:
    """A speed that is logged too large or too small, or r, as the motion across tells, and worth its parameters.

    Where wheels are turned far they scrub, as both would have to turn by angles of their own: that asks for a scale.
    """
    if not final.model.ode.small_angles:
        return []
    for other in (other for other, share in others if {*SPEED} <= {*other.free} and share > _HALF):
        if worth(final, other, len(other.names) - len(final.names)) <= 0:
            continue
        gain, how = other.values[SPEED[0]], "small" if other.values[SPEED[0]] > 1 else "large"
        return [
            f"v_x is logged {100 * abs(1 / gain - 1):.2g} % too {how}, or r is too {how} (a gyro's scale), as the "
            "motion across tells: see whether r adds up over a full circle; if so and v_x is that of wheels, check "
            f"their radius, or give v_x a scale of {gain:.3g}; stiffness and inertia are off with it, and their "
            "intervals hold for either speed"
        ]
    return []


def bounds(final: Fitted, used: float) -> list[str]:
    """Friction beyond that which the log reached, ``used`` [-], and parameters that end at a bound."""
    limits = {n: v for n, v in final.values.items() if n in ("mu_f", "mu_r") and v < 0.99 * final.model.si(n).upper}
    said = []
    if limits and min(limits.values()) > _BEYOND * used:
        found = ", ".join(f"{n} = {v:.2g}" for n, v in limits.items())
        said.append(
            f"{found} are read from the bend of the tire curves: the log uses {used:.2g} at most, and what the car "
            "does beyond is extrapolated; drive nearer the limit before relying on it"
        )
    for name, base in zip(final.names, final.problem.base_names, strict=True):
        value, si = final.values[name], final.model.si(base)
        if name in ("mu_f", "mu_r") and value > 0.99 * si.upper:
            said.append(
                f"the log does not reach the {'front' if name == 'mu_f' else 'rear'} axle's friction: it has no value"
            )
        elif min(abs(value - si.lower), abs(value - si.upper)) < 1e-6 * max(abs(value), 1e-3) and base not in (
            "delay_delta",
            "delay_delta_r",
            "delay_M_z",
            "relaxation_f",
            "relaxation_r",
            "shape",
            "steering_lag",
            *LOADS,
        ):
            said.append(f"{name} ends at its bound, {value:.4g} {si.unit}; expected an interior value: check the units")
    return said


def unsettled(final: Fitted) -> list[str]:
    """A last fit that was ended while it moved."""
    if final.settled:
        return []
    return [
        "the last fit did not settle: its weights and its parameters still moved each other when it was ended, so "
        "other starts may end elsewhere; a longer log, or one with more steering, decides it"
    ]


def short(value: float) -> str:
    """Three digits of a number, thousands apart."""
    digits = max(0, 2 - int(np.floor(np.log10(abs(value))))) if value else 0
    return f"{round(value, 2 - int(np.floor(np.log10(abs(value))))) if value else 0.0:,.{digits}f}".replace(",", " ")
