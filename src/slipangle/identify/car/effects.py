"""Whether an effect that was fitted to a log is one, or stands in for something else; and what it is, in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.identify.car.corrections import (
    DOWNFORCE,
    FAST,
    LEVER,
    LOCKED,
    RATE,
    REAR,
    SCALE,
    SLOW,
    SPEED,
    Correction,
)
from slipangle.identify.car.structures import (
    AS_GOOD,
    ELSEWHERE,
    Fitted,
    Stage,
    change,
    corrected,
    errors,
    fit,
    fit_error,
    free_runs,
)
from slipangle.identify.car.uncertainty import covariance

WEIGHT = (0.2, 0.8)  # of the wheelbase, between which is any car's centre of gravity
_INSIDE = 0.1  # of the wheelbase, from these ends on which such a place counts whole
_LEAST = 0.1  # of an axle's load at rest, the least that downforce adds in fast driving
_RESISTS = 0.1  # of the tires' yaw damping, the least that a locked axle adds
_AWAY = 0.1  # by how much farther from the given one, as a logarithm, a locked axle may move the steering's gain
_SHARP = 0.05  # half of the steering's largest rate's interval, over it, at most
_SLOWED = 0.05  # of what the outputs move by, the least that such a rate changes
_NO_LIMIT = 1e6  # rad/s, of a steering's rate
_NONE_OF = {DOWNFORCE: 0.0, LOCKED: 0.0, RATE: np.inf, SCALE: 1.0}  # what an effect is where there is none
_SCALES = {
    SPEED: 0.03,
    SCALE: 0.05,
    REAR: 0.1,
}  # of what is logged, the least by which one is said to be wrong
_DOES = {"drive_rear": "drives", "brake_rear": "slows"}  # the car, by that share of it on the rear wheels
_TELLING = 0.5  # wider than which the interval of such a share tells nothing
_WINGED = 1.25  # friction used, from which a car may have wings
_NO_HEIGHT = 1e-3  # of the wheelbase, up to which no load shifts
_NONE = 1.5  # of `AS_GOOD`, from which a structure is not believed at all; of `ELSEWHERE`, up to which a lever is one
# Standard deviations from none at which an effect just is one, and at which it counts whole; of a speed's scale they
# are more, as cars that roll much asked for one by up to 3.7, and of v_y's, beside its sensor's place, by as much.
_SURE, _SURE_SPEED = (1.96, 3.92), (4.0, 6.0)
_BRUSHES = 0.5  # how far brushes count that explain a log just as well, as real tires are in between
_HEARD = 0.5  # share of v_y's variance that is explained at least where its scale is told
_ANY = 2.0  # of what needs no other proof than that it helps


def told(fitted: Fitted, names: tuple[str, ...]) -> float:
    """How far the effect of the parameters ``names`` is beyond what stands in for something else, 1 where it just is.

    Downforce adds a tenth to an axle's load in fast driving, as wings do, a locked axle a tenth to the yaw damping, and
    stretches of unlike speed and size agree that there is some. A largest rate of the steering is sharp and changes the
    outputs by a twentieth, else it stands in for a lag of another shape. A speed is wrong by a few percent or more,
    rear wheels by a tenth; a v_y sensor of another scale reads what is explained on it, and is elsewhere too from a
    twentieth of the wheelbase on. Lift of that size has no car that is driven so fast: it is what roads and drivers do
    with speed.
    """
    lever = names == LEVER and {*SCALE} <= {*fitted.free}
    if not lever and names not in (DOWNFORCE, LOCKED, RATE, *_SCALES):
        return _ANY
    if names == SCALE and explained(fitted)[fitted.model.outputs.index("v_y")] < _HEARD:
        return 0.0
    std = np.sqrt(np.maximum(np.diag(covariance(fitted)[0])[[fitted.names.index(name) for name in names]], 0.0))
    if names == DOWNFORCE:
        size = (_ratios(fitted, FAST) - 1.0) / _LEAST
    elif names == LOCKED:
        size = np.array([fitted.model.ode.params.locked_share / _RESISTS])
    elif lever:
        size = np.array([abs(fitted.values[LEVER[0]]) / (ELSEWHERE * fitted.model.value("wheelbase"))])
    elif names == RATE:
        sharp = _SHARP * fitted.values[RATE[0]] / np.maximum(_SURE[0] * std, 1e-300)
        size = np.minimum(sharp, _slowed(fitted) / _SLOWED)
    else:
        size = np.abs([fitted.values[name] - 1.0 for name in names]) / _SCALES[names]
    beside = names == SCALE and {*LEVER} <= {*fitted.free}
    none, (just, whole) = float(names in _SCALES), _SURE_SPEED if names == SPEED or beside else _SURE
    away = np.abs([fitted.values[name] - none for name in names]) / np.maximum(std, 1e-300)
    return float(np.max(np.minimum(size, 1.0 + (away - just) / (whole - just))))


def explained(fitted: Fitted) -> np.ndarray:
    """Share of each output's variance that is explained, of v_y but for what a turned sensor reads of the speed. [-]"""
    data, moves = fitted.problem.data, []
    for name in fitted.model.outputs:
        zeros = np.column_stack([np.ones(len(data)), data["v_x"] * (name == "v_y")])
        moves.append(np.std(data[name] - zeros @ np.linalg.lstsq(zeros, data[name], rcond=1e-9)[0]))
    return 1 - (fitted.sigma / np.maximum(moves, 1e-300)) ** 2


def _slowed(fitted: Fitted) -> float:
    """By how much a largest rate of the steering changes the outputs, over what they move by: the most of any. [-]"""
    data, fast = fitted.problem.data, fitted.model.with_values(**dict.fromkeys(RATE, _NO_LIMIT))
    slow, fast = (np.concatenate([run for run, _ in free_runs(f, data)]) for f in (fitted, replace(fitted, model=fast)))
    return float(np.max(np.std(slow - fast, axis=0) / np.maximum(np.std(slow, axis=0), 1e-300)))


def believed(final: Fitted, stages: list[Stage], data: Dataset) -> tuple[Fitted, list[Stage]]:
    """A last fit without effects that are none, and the stages: what a part of the log told, all of it may not."""
    stages = [*stages]
    for names, none in _NONE_OF.items():
        if {*names} <= {*final.free} and told(final, names) < 1.0:
            left = tuple(n for n in final.free if n not in names)
            without = final.model.with_values(**dict.fromkeys(names, none))
            final = fit(without, left, data, final, own=final.own, last=True)
            at = next(i for i, stage in enumerate(stages) if stage.kept and {*names} <= {*stage.values})
            stages[at] = replace(stages[at], kept=False)
    return final, stages


def turned_away(first: Fitted, before: Fitted, after: Fitted) -> bool:
    """Whether a locked axle would be bought by a steering gain farther than before from the given one, ``first``'s.

    Both ask for more steering in any bend, so that each may stand in for the other where a log tells little.
    """
    if not {*LOCKED} <= {*after.free} - {*before.free}:
        return False
    given, *found = (f.model.value("steering_gain") for f in (first, before, after))
    was, now = np.abs(np.log(np.abs(np.array(found) / given)))
    return bool(now > was + _AWAY)


def outdone(before: Fitted, after: Fitted, by: Correction, data: Dataset) -> bool:
    """Whether the place or the scale of the v_y sensor, or a scale of v_x, explains more than what was tried, alone.

    Each of them, and a locked axle, takes a part of what another does: a fault is what explains most by itself. Two of
    them together explain any log a little better, with neither at its value. A scale of v_y is that of r, upside down:
    motion that is larger as a whole is that of larger steering.
    """
    if by.free not in (LEVER, SCALE, LOCKED):
        return False
    for names in (LEVER, SCALE, SPEED):
        if {*names} & {*after.free, *before.free, *before.own}:
            continue
        gain = ("steering_gain",) if names == SPEED and "steering_gain" not in before.own else ()
        other = fit(before.model, tuple(dict.fromkeys((*before.free, *names, *gain))), data, before, own=before.own)
        if fit_error(other) < fit_error(after) and told(other, names) >= 1.0:
            return True
    return False


def extrapolated(fitted: Fitted) -> dict[str, float]:
    """By how much stiffness and friction at rest may be off, as shares of them: by what they gain until slow driving.

    No log shows a car at rest; from there to its slow driving a model in proportion to load is a guess.
    """
    if not {*DOWNFORCE} <= {*fitted.free}:
        return {}
    front, rear = np.abs(_ratios(fitted, SLOW) - 1.0)
    return {"C_f": front, "mu_f": front, "C_r": rear, "mu_r": rear}


def others_as_good(final: Fitted, dropped: list[Correction], data: Dataset) -> list[tuple[Fitted, float]]:
    """Structures that explain the data about as well as the chosen one, and how far each counts, 0 to 1.

    With a correction more, such as tires of another shape; with tires that yield as a brush does; with a centre of
    gravity elsewhere too, which is hard to tell from another place of the v_y sensor, if there is one and the data want
    it where a car's may be. Nothing counts all at once, so that no rounding decides an interval.
    """
    at, known = errors(final, data), {"before": final, "own": final.own}

    def worse(other: Fitted) -> float:
        return change(at, errors(other, data))[0] / AS_GOOD

    trials = list[tuple[Fitted, float]]()
    for correction in (c for c in dropped if not c.own):
        other = corrected(final, correction, data)
        trials.append((other, told(other, correction.free) - 1.0))
    if {"v_y", "a_y"} & {*final.model.outputs}:
        free = dict.fromkeys((*final.free, "steering_gain", *SPEED))  # speed and gain may be wrong by the same share
        scaled = fit(final.model, tuple(n for n in free if n not in final.own), data, **known)
        trials.append((scaled, told(scaled, SPEED) - 1.0))
    wheelbase = final.model.value("wheelbase")
    sits = abs(final.values.get("lever_v_y", 0.0)) / (ELSEWHERE * wheelbase)  # as a wrong l_f would
    if sits > 0.5:
        moved = fit(final.model, (*final.free, "l_f"), data, **known)
        away = abs(moved.values["l_f"] - final.model.value("l_f")) / (ELSEWHERE * wheelbase)
        at_share = moved.values["l_f"] / wheelbase
        possible = min(at_share - WEIGHT[0], WEIGHT[1] - at_share) / _INSIDE
        trials.append((moved, min(away - _NONE, possible, 2.0 * sits - 1.0)))
    brushed = _brushed(final, data)
    counted = [(brushed, float(min(_BRUSHES - worse(brushed), 1.0)))]
    counted += [(other, float(min(share, _NONE - worse(other), 1.0))) for other, share in trials]
    return [(other, share) for other, share in counted if share > 0]


def _brushed(final: Fitted, data: Dataset) -> Fitted:
    """The car on brushes, whose slope falls from the very start: with the slip, a Magic Formula's with its square.

    Seldom tells a log the one from the other, and at a third of the grip a brush's stiffness is 3 % more, at nine
    tenths 10 %. Where no axle was found to saturate, both do from ordinary friction on.
    """
    frictions = ("mu_f", "mu_r")
    start = final.model.with_values(brush=1.0, **{name: 1.0 for name in frictions if name not in final.names})
    free = dict.fromkeys(n for n in (*final.free, *frictions) if n != "shape")
    return fit(start, tuple(free), data, final, own=final.own)


def _ratios(fitted: Fitted, share: float) -> np.ndarray:
    """Loads of both axles over those at rest, at a quantile of the speeds that were driven."""
    v_x = float(np.quantile(fitted.problem.data["v_x"], share))
    return np.array(fitted.model.ode.params.load_ratios(v_x), dtype=float)


def in_words(final: Fitted, limits: np.ndarray, used: float) -> list[str]:
    """What was found beside tires, downforce and a locked axle, with ``limits`` of shape (n_names, 2)."""
    return [*wings(final, limits, used), *locked(final, limits), *pitching(final, limits)]


def wings(final: Fitted, limits: np.ndarray, used: float) -> list[str]:
    """Downforce that was found, with its limits, of shape (n_names, 2); none on friction that needs some, ``used`` [-].

    What was found is what the tires make of it, see `SaturatingBicycleParams`.
    """
    if not {*DOWNFORCE} <= {*final.names}:
        said = (
            f"the log uses a friction of {used:.2g} and tells no downforce: if the car has wings, C_f, C_r and "
            "friction are those of the speeds that were driven; drive alike at low and at high speed to tell it"
        )
        return [said] if used > _WINGED else []
    fastest = float(np.quantile(final.problem.data["v_x"], FAST))
    front, rear = final.model.ode.params.load_ratios(fastest)
    found = (
        f"{n} = {final.values[n]:.2g} ({low:.2g} to {high:.2g})"
        for n, (low, high) in zip(DOWNFORCE, (limits[final.names.index(n)] for n in DOWNFORCE), strict=True)
    )
    return [
        f"stiffness and grip grow with speed as by {' and '.join(found)} kg/m: at {fastest:.3g} m/s they are "
        f"{front:.3g} and {rear:.3g} times C_f, C_r, mu_f and mu_r, which are those at rest; that of wings is more, "
        "often several times, as tires gain less than in proportion to load, and a car without any has something else "
        "that grows with speed"
    ]


def pitching(final: Fitted, limits: np.ndarray) -> list[str]:
    """How far braking was found to shift loads, and which wheels brake and drive; limits of shape (n_names, 2)."""
    if "height" not in final.names or final.values["height"] < _NO_HEIGHT * final.model.value("wheelbase"):
        return []
    low, high = limits[final.names.index("height")]
    share = 100 * final.values["height"] / final.model.value("wheelbase")
    said = [
        f"stiffness and grip move to the front axle as the car brakes, by {share:.2g} % of the weight per g, as of a "
        f"centre of gravity {final.values['height']:.2g} ({low:.2g} to {high:.2g}) m above ground: tires that gain "
        "less than in proportion to load make it less than it is"
    ]
    shares = ((verb, final.values[name], *limits[final.names.index(name)]) for name, verb in _DOES.items())
    found = [
        f"{100 * value:.0f} % ({100 * low:.0f} to {100 * high:.0f}) of what {verb} the car"
        for verb, value, low, high in shares
        if high - low < _TELLING
    ]
    if found and low > 0:  # where no load need shift, they stand in for something else
        said.append(f"{' and '.join(found)} acts on the rear wheels, as the grip that it takes tells")
    return said


def locked(final: Fitted, limits: np.ndarray) -> list[str]:
    """A rear axle that was found to resist the turn, with its limits, of shape (n_names, 2)."""
    if not {*LOCKED} <= {*final.names}:
        return []
    (name,), p = LOCKED, final.model.ode.params
    low, high = limits[final.names.index(name)]
    return [
        f"the rear wheels resist the turn as if they turned as one, by {100 * p.locked_share:.2g} % of what slip "
        f"angles do: {name} = {final.values[name]:.2g} ({low:.2g} to {high:.2g}) m, about half the track where the "
        "axle is solid or its differential locked; with an open differential in the car something else does it, as a "
        "yaw rate that reads too small, and yaw inertia and steering gain are less sure than their intervals say"
    ]
