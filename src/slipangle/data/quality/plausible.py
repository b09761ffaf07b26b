"""Whether the channels of a car's log agree with each other: signs, units, clocks, sensors that stick."""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.data.quality.clipped import clipped
from slipangle.data.quality.lateness import late
from slipangle.data.quality.regression import about_means, by_blocks, coefficient, explained, lag_of, rate_of, slope_of
from slipangle.data.quality.slow_motion import (
    SPEEDS,
    offset_of_r,
    over_the_rear,
    smoothed,
    speeds_differ,
    straightness,
    without,
)
from slipangle.data.quality.speed_scale import scaled
from slipangle.data.quality.stuck import stuck
from slipangle.data.quality.swapped import FELT, TIED, with_a_y, with_steering
from slipangle.data.recordings import by_recording, repeated

# Share of the logged angle that the motion asks for, about half of the truth to all of it where understeer cannot be
# told, and what explains it.
_SHARES = (
    (0.0, 0.024, "delta is logged in degrees: declare its unit as deg"),
    (0.024, 0.115, "delta is the angle of the hand wheel: give the steering ratio, about {ratio}"),
    (0.115, 0.36, "{speed}delta is a command: give steering_gain, about {gain}"),
    (15.0, 120.0, "{wrong}"),
)
_AT_ONE_SPEED = 0.3  # such a share, where understeer cannot be told, up to which more is said than that it understeers
_IN_DEGREES = "r is logged in deg/s: declare its unit as deg/s"
_IN_RADIANS = "delta is logged in rad, and was declared as deg: declare its unit as rad"  # where r turns as a car may
_CERTAIN = 2.0  # standard errors of a share, within which it has to stay where none is usual
_SPEED = "v_x is logged in km/h: declare its unit as km/h, or "  # where no a_y says that it is right
_MOVING = 0.3  # share of the steering's variance inside drives, from which they tell the gain by themselves
_LATE = 0.15  # s
_SIDEWAYS = 15.0  # m/s2 of v_x r, from which r is not in rad/s
_AGREE = 0.4  # correlation of r wheelbase / v_x with delta, below which they tell nothing of each other
_FOLLOWS = 0.75  # that correlation of v_y, from which they are swapped where r's is below _AGREE
_LEADS, _TIED = 0.5, 0.5  # wheelbases that a_y is ahead of r, and agreement from which their lag is told
_BETTER = 0.9  # of what steady driving does not tell of v_y, below which v_x v_y is what moves as v_y should
_OUTSIDE = 1.35  # wheelbases ahead of the rear axle, where no v_y is measured
_IN = 0.1  # wheelbases from the rear axle, beyond which a place is not zero
_SHORT = 0.25  # s, wheelbase over speed up to which v_y is far smaller than v_x r
_ZERO = 0.09  # rad/s, offset of r that a fit hardly reaches
_TURNED = 0.01  # rad, by which a v_y sensor is turned at least: banked roads and side wind make half of it
_BEYOND = 80.0  # m/s2 of v_x r, more than any car with wings has
_CHANGES = "v_x or r is in another unit, if only over a part of the log; look at both over time"
_ORDINARY = 0.45, 2.2  # gain of a steering logged as road-wheel angle, as it looks with understeer in it
_SESSION = 28.0  # s of a recording, from which it is looked at by itself
TURNED = "its sensor is turned by"  # as a fit corrects
REAR = 0.35  # rad, further than which hardly any rear wheels are steered
LONGEST_STEP = 0.5  # s, between samples of a car that is steered
_FELT, _SURELY = (0.85, 1.22), 0.9  # a_y over v_x r that needs no word, and agreement from which it is sure
_OF_A_Y = (  # a_y over v_x r from, to, in words, and whether v_x or r is wrong
    (1 / 110, 1 / 30, "of v_x r: r is logged in deg/s; declare its unit as deg/s", True),
    (1 / 14, 1 / 6, "of v_x r: a_y is logged in g; declare its unit as g", False),
    (1 / 4.6, 1 / 2.6, "of v_x r: v_x is logged in km/h; declare its unit as km/h", True),
    (1 / 2.6, 1 / 1.9, "of v_x r: v_x is logged in mph; declare its unit as mph", True),
    (2.6, 4.6, "times v_x r: v_x is declared in km/h and logged in m/s; declare its unit as m/s", True),
    (6.0, 14.0, "times v_x r: a_y is declared in g and logged in m/s2; declare its unit as m/s2", False),
    (30.0, 110.0, "times v_x r: r is declared in deg/s and logged in rad/s; declare it as rad/s", True),
)


def doubts(data: Dataset, *, wheelbase: float) -> tuple[str, ...]:
    """Sentences about channels that contradict each other, each with what to change; none for a sound log.

    Kinematics ties delta, v_x and r together, ``r wheelbase / v_x = gain delta`` at low speed, less ``delta_r`` of
    steered rear wheels, and v_x, r and a_y, ``a_y = v_x r`` in steady cornering. ``data`` has delta [rad], v_x [m/s],
    r [rad/s], and v_y, a_x, a_y, delta_r [rad] where measured; ``wheelbase`` is in m. No yaw rate comes before its
    steering, no speed behind its acceleration. Of several recordings of half a minute or more, what is odd in half of
    them or fewer, or of which all together show nothing, is said of these.
    """
    parts = by_recording(data)
    long = {k: part for k, part in parts.items() if part.n_samples * data.dt > _SESSION}
    again = [
        f"recording {j + 1} has the samples of recording {i + 1} again: they count twice, and intervals are too "
        "narrow; leave one out"
        for i, j in repeated(long, ("delta", "r"))
    ]
    each = {k: _doubts(part, wheelbase) for k, part in long.items()} if len(long) > 1 else {}
    sound = [k for k, one in each.items() if not one and _turns(parts[k], wheelbase)] if any(each.values()) else []
    together = _doubts(data, wheelbase)
    if not any(each.values()) or (together and 2 * len(sound) < len(each)):  # one mistake looks otherwise by speed
        return (*again, *together)
    said = [f"in recording {k + 1} of {max(parts) + 1}: {sentence}" for k, one in each.items() for sentence in one]
    others = [part for k, part in parts.items() if not each.get(k)]
    return (*again, *said, *(_doubts(join(*others), wheelbase) if others else ()))


def _turns(data: Dataset, wheelbase: float) -> bool:
    """Whether r follows delta about as wheelbase and speed have it."""
    low, high = _ORDINARY
    return low < kinematic_gain(data, wheelbase=wheelbase) < high


def _doubts(data: Dataset, wheelbase: float) -> tuple[str, ...]:
    """See `doubts`, of all data together."""
    if data.dt > LONGEST_STEP:
        return (
            f"samples are {data.dt:.3g} s apart; expected less than {LONGEST_STEP:g} s of a car that is steered: if "
            "time is logged in milliseconds (ms), declare its unit as ms",
        )
    if np.quantile(data["v_x"], 0.9) <= 0:
        return (
            "v_x is hardly ever above zero: it has the wrong sign, or the car stands or reverses; forward is positive",
        )
    held = stuck(data)
    said = [
        f"{name} is stuck at one value for {max(b - a - 1 for a, b in rows) * data.dt:.2g} s while the car "
        f"{'turns' if name == 'delta' else 'is steered'}: cut that out, or mend the sensor"
        for name, rows in held.items()
    ]
    fast, smooth, drives = smoothed(without(data, held, wheelbase), [n for n in data.names if n in _CHANNELS])
    if not fast:
        return tuple(said)
    if _swapped(smooth, wheelbase, drives):
        return (*said, "v_y moves as r should, with delta, and r as v_y: r and v_y are swapped; check their columns")
    if with_a_y(smooth, tuple(each[:2] for each in _OF_A_Y)):
        return (*said, "r moves as a_y should, as v_x a_y does: r and a_y are swapped; check their columns")
    if _swapped_with_steering(fast, smooth, wheelbase, drives):
        return (*said, "r comes before delta, and moves as delta should: delta and r are swapped; check their columns")
    cornering, about_r = _cornering(fast, smooth, wheelbase)
    said += cornering
    rear = _rear(smooth)
    said += rear
    if not about_r and not rear:
        speed = "" if _speed_agrees(smooth) else _SPEED
        about = (_steering(smooth, wheelbase, drives, speed), _sideways(smooth, wheelbase, drives))
        if all("wrong sign" in said for each in about for said in each or ("",)):
            return (*said, "r moves against delta and against v_y: it has the wrong sign; set sign = -1 for r")
        said += (about[0] or _zero(smooth, drives)) + about[1]
    beyond = float(np.quantile(np.abs(smooth["v_x"] * smooth["r"]), 0.99))
    if beyond > _BEYOND and not said:
        said.append(f"v_x r reaches {beyond:.3g} m/s2, which no tires give: {_CHANGES}")
    said += [] if said else [*late(fast, wheelbase), *scaled(fast), *clipped(fast, wheelbase)]  # signs and units first
    return tuple(said)


def kinematic_gain(data: Dataset, *, wheelbase: float) -> float:
    """The steering's gain that r wheelbase / v_x shows at low frequencies, to a third or so, negative if it turns. [-]

    0 where r does not follow delta, up or down, or the drives are too short to tell. Channels and units as in `doubts`.
    """
    names = [n for n in ("delta", "v_x", "r", "delta_r") if n in data.names]
    parts, smooth, drives = smoothed(without(data, stuck(data), wheelbase), names)
    if not parts or np.quantile(data["v_x"], 0.9) <= 0:
        return 0.0
    gain, agree, _, _ = _asked(smooth, wheelbase, drives)
    return gain if abs(agree) > _AGREE else 0.0


def a_y_of_turning(data: Dataset) -> float:
    """a_y over v_x r at low frequencies, to which body roll adds; 0 where a_y is not logged or does not follow. [-]"""
    if "a_y" not in data:
        return 0.0
    parts, smooth, _ = smoothed(data.experiments, ["v_x", "r", "a_y"])
    slope, agree = slope_of(smooth["v_x"] * smooth["r"], smooth["a_y"]) if parts else (0.0, 0.0)
    return slope if agree > _FOLLOWS else 0.0


def _swapped_with_steering(
    fast: list[Dataset], smooth: dict[str, np.ndarray], wheelbase: float, drives: np.ndarray
) -> bool:
    """Whether delta and r are under each other's name."""
    if "delta_r" in smooth:
        return False
    back = smooth | {"r": smooth["delta"], "delta": smooth["r"]}
    now, then = (_asked(each, wheelbase, drives)[:2] for each in (smooth, back))
    return with_steering(fast, now, then)


_CHANNELS = ("delta", "v_x", "r", "v_y", "a_y", "delta_r")


def _cornering(fast: list[Dataset], smooth: dict[str, np.ndarray], wheelbase: float) -> tuple[list[str], bool]:
    """Sentences on a_y, or v_y, beside v_x r, and whether one says that v_x, r or their units are wrong."""
    turn = smooth["v_x"] * smooth["r"]
    other, agree_y = slope_of(turn, smooth["v_y"]) if "v_y" in smooth else (0.0, 0.0)
    like_a_y = agree_y > 0.9 and 0.5 < other < 2
    if "a_y" not in smooth:
        if like_a_y and wheelbase < _SHORT * float(np.mean(smooth["v_x"])):
            return ["v_y moves as a_y should, as v_x r does: it is a lateral acceleration, name it a_y"], False
        return [], False
    slope, agree = slope_of(turn, smooth["a_y"])
    if like_a_y and agree < 0.7 and min(abs(agree) / 0.7, abs(slope) / 0.5) < 1:
        return ["v_y moves as a_y should, as v_x r does, and a_y does not: v_y and a_y are swapped"], False
    if agree < -0.7:
        return ["a_y moves against v_x r: r or a_y has the wrong sign; expected axes of ISO 8855, y left"], False
    late, tied = _late(fast)
    ahead = _LEADS * wheelbase * float(np.sum(turn**2) / max(np.sum(turn**2 * smooth["v_x"]), 1e-300))
    if late > _LATE + ahead and tied > _TIED:
        return [f"r comes {late:.2f} s behind a_y: it is logged late; shift it, or take another sensor"], True
    for low, high, words, wrong in _OF_A_Y:
        if agree >= 0.7 and low < slope < high:
            return [f"a_y is {slope:.2g} {words}"], wrong
    v = smooth["v_x"]
    zero = [v] if np.ptp(v) > SPEEDS * v.mean() else []  # of r; at one speed it is one of a_y
    table = np.column_stack([turn, *zero, np.ones(len(turn)), smooth["a_y"]])
    slope, error = coefficient(by_blocks(table, np.repeat(np.arange(len(fast)), [len(part) for part in fast])))
    beyond = _CERTAIN * error < max(_FELT[0] - slope, slope - _FELT[1])
    if "v_y" not in smooth or agree < _SURELY or not beyond:  # without v_y a fit finds the scale
        return [], False
    said = f"a_y is {slope:.3g} times v_x r; expected 1 to 1.15, as body roll adds to it: the scale of a_y is off, or "
    return [said + "that of r or v_x; see whether r adds up over a full circle"], False


def _speed_agrees(smooth: dict[str, np.ndarray]) -> bool:
    """Whether a_y is about v_x r, so that no unit of v_x is wrong."""
    slope, agree = slope_of(smooth["v_x"] * smooth["r"], smooth["a_y"]) if "a_y" in smooth else (0.0, 0.0)
    return agree > TIED and FELT[0] < slope < FELT[1]


def _late(fast: list[Dataset]) -> tuple[float, float]:
    """How long v_x r comes after a_y [s], and how far they agree then, 0 to 1."""
    return lag_of([(part["a_y"], part["v_x"] * part["r"]) for part in fast], fast[0].dt)


def _steering(smooth: dict[str, np.ndarray], wheelbase: float, drives: np.ndarray, speed: str) -> list[str]:
    """Sentences on delta beside r wheelbase / v_x; ``drives`` numbers the experiment of each sample.

    ``speed`` is what may be wrong with the speed, where that may be.
    """
    gain, agree, speeds, error = _asked(smooth, wheelbase, drives)
    if agree < -0.6:
        return [
            f"r moves against delta (agreement {agree:.2f}): one has the wrong sign; set sign = -1 for delta, left is "
            "positive"
        ]
    sure = _CERTAIN * error
    if agree < _AGREE or _SHARES[-2][1] - sure < gain < _SHARES[-1][0] + sure:
        return []
    turns = float(np.quantile(np.abs(smooth["v_x"] * smooth["r"]), 0.99)) > _SIDEWAYS
    wrong = _IN_DEGREES if turns else _IN_RADIANS
    return [
        f"r wheelbase / v_x is about {gain:.2g} of delta: "
        f"{words.format(**_at_most_twice(gain, 1 + sure / gain), speed=speed, wrong=wrong)}"
        for low, high, words in _SHARES
        if low < gain <= high and (speeds or "command" not in words)
    ] or _at_one_speed(gain, sure, speed)


def _at_one_speed(gain: float, sure: float, speed: str) -> list[str]:
    """A sentence on a share of delta that a speed in km/h has, or a command, or much understeer at the one speed."""
    if not (speed and _SHARES[-2][0] < gain < _AT_ONE_SPEED - sure):
        return []
    return [
        f"r wheelbase / v_x is about {gain:.2g} of delta at the one speed that was driven: {speed}delta is a command, "
        "or the car understeers that much; drive at another speed to tell, until then no interval holds"
    ]


def _at_most_twice(gain: float, room: float) -> dict[str, str]:
    """Steering ratio and gain in words, with their ranges: of a share that is half of the truth to all of it.

    ``room`` is the factor either way by which the share is sure.
    """
    low, high = gain / room, 2 * gain * room
    return {
        "ratio": f"{1 / gain:.0f} ({1 / high:.0f} to {1 / low:.0f}, as understeer may be in it)",
        "gain": f"{gain:.2g} ({low:.2g} to {high:.2g}, as understeer may be in it)",
    }


def _rear(smooth: dict[str, np.ndarray]) -> list[str]:
    """A sentence on the angle of steered rear wheels by its size."""
    largest = float(np.quantile(np.abs(smooth.get("delta_r", np.zeros(1))), 0.99))
    if largest <= REAR:
        return []
    return [
        f"delta_r is up to {largest:.2g} rad; expected at most {REAR:g} rad of rear road wheels: if it is logged in "
        "degrees, declare its unit as deg"
    ]


def _asked(smooth: dict[str, np.ndarray], wheelbase: float, drives: np.ndarray) -> tuple[float, float, bool, float]:
    """Share of delta that r wheelbase / v_x is, their correlation, whether speeds differ enough, and its error.

    Where rear wheels are steered, delta is that of the front ones over them, which is what turns a car. Each drive has
    an offset of its own, as its steering sensor may, where the steering moves enough inside drives. Understeer is told
    from the share where speeds differ, and how late the car is, to first order, always: what is late looks smaller.
    The error is a standard one, of a jackknife over blocks.
    """
    v, r, delta = smooth["v_x"], smooth["r"], over_the_rear(smooth)
    fast = v > 0.3 * np.quantile(v, 0.9)
    turn = r * wheelbase / np.where(fast, v, np.inf)
    later = rate_of(turn, drives)[fast]
    v, r, delta, drives, asked = v[fast], r[fast], delta[fast], drives[fast], turn[fast]
    _, agree = slope_of(delta, asked)
    inside = about_means(delta, drives)
    if np.sum(inside**2) < _MOVING * np.sum((delta - delta.mean()) ** 2):
        drives = np.zeros_like(drives)
    columns, speeds = [delta, -later], speeds_differ(v, r)
    if speeds:  # understeer, which at one speed cannot be told from the steering's gain
        columns.append(-v * r * wheelbase)
    table = np.column_stack([about_means(column, drives) for column in (*columns, asked)])
    gain, error = coefficient(by_blocks(table, drives))
    return gain, agree, speeds, error


def _zero(smooth: dict[str, np.ndarray], drives: np.ndarray) -> list[str]:
    """A sentence on an offset of r beyond what a fit corrects, see `offset_of_r`."""
    value, error = offset_of_r(smooth, drives)
    if abs(value) < max(_ZERO, 5 * error):
        return []
    return [f"r reads {value:.2g} rad/s on a straight: its sensor has an offset; subtract it"]


def _sideways(smooth: dict[str, np.ndarray], wheelbase: float, drives: np.ndarray) -> list[str]:
    """A sentence on sign or unit of v_y: in steady cornering it is r (l_r - K v_x^2), with K > 0 for any tires.

    In other cornering its own rate, and that of r, add to the force on the rear axle.
    """
    v = smooth["v_x"]
    if "v_y" not in smooth or np.ptp(v) < SPEEDS * v.mean():
        return []
    turned = _turned(smooth, drives)
    if turned:
        return [
            f"v_y is {turned:.2g} of v_x on a straight: {TURNED} {np.rad2deg(turned):.2g} deg; subtract that share of "
            "v_x from it"
        ]
    if not speeds_differ(v, smooth["r"]):
        return []
    squares, told = _slips(smooth, drives)
    if _is_angle(smooth, drives, wheelbase, told):
        return [
            "v_y moves as a side slip angle does, at low speed in proportion to r over v_x: derive v_y as v_x times "
            "its tangent, or give the column another name"
        ]
    if told < _TIED:
        return []
    (arm, sure), (softness, certain) = (coefficient(squares, k) for k in range(2))
    sure, certain, farthest = _CERTAIN * sure, _CERTAIN * certain, _OUTSIDE * wheelbase
    if -farthest < arm < -sure and softness < -certain:
        return ["v_y moves against r at low speed and with it at high speed: it has the wrong sign; left is positive"]
    if softness > 0 and arm - sure > farthest:
        return [
            f"v_y is that of a place {arm:.2g} m ahead of the rear axle, at a wheelbase of {wheelbase:g} m: it is "
            "logged in km/h or another unit; declare it"
        ]
    return []


def _turned(smooth: dict[str, np.ndarray], drives: np.ndarray) -> float:
    """Angle by which the v_y sensor is turned to the left of straight ahead, with its sign; 0 where none shows. [rad]

    It reads a share of the speed, beside an offset of its own and what `_slips` has, of r without its offset, which
    would make slip; that grows as understeer in `offset_of_r`.
    """
    (zero, sure), v, v_y = offset_of_r(smooth, drives), smooth["v_x"], smooth["v_y"]
    r = smooth["r"] - (zero if abs(zero) > _CERTAIN * sure else 0.0)
    steady = r, -r * v * v, v * rate_of(r, drives), -v * rate_of(v_y, drives), v * (v * r) ** 3
    table = np.column_stack([v, *steady, np.ones(len(v)), v_y]) * straightness(v * r)[:, None]
    value, error = coefficient(by_blocks(table, drives))
    return value if abs(value) > max(_TURNED, 5 * error) else 0.0


def _is_angle(smooth: dict[str, np.ndarray], drives: np.ndarray, wheelbase: float, told: float) -> bool:
    """Whether v_x v_y, and not v_y, of which steady driving tells the share ``told``, is that of a place in the car."""
    squares, better = _slips(smooth | {"v_y": smooth["v_x"] * smooth["v_y"]}, drives)
    if better < _TIED or 1 - better > _BETTER * (1 - told):
        return False
    arm, sure = coefficient(squares, 0)
    return _IN * wheelbase < abs(arm) - _CERTAIN * sure and abs(arm) + _CERTAIN * sure < _OUTSIDE * wheelbase


def _slips(smooth: dict[str, np.ndarray], drives: np.ndarray) -> tuple[np.ndarray, float]:
    """Products of what v_y is made of, and of v_y, in blocks, see `_sideways`; the share that steady driving tells."""
    v, r = smooth["v_x"], smooth["r"]
    columns = r, -r * v * v, v * rate_of(r, drives), -v * rate_of(smooth["v_y"], drives), smooth["v_y"]
    squares = by_blocks(np.column_stack([about_means(column, drives) for column in columns]), drives)
    return squares, explained(squares, by=2)


def _swapped(smooth: dict[str, np.ndarray], wheelbase: float, drives: np.ndarray) -> bool:
    """Whether v_y follows delta as r should, which r does not, as one that is late still does, and r is as v_y is."""
    if "v_y" not in smooth or "delta_r" in smooth:  # a wrong one of which would hide how r follows delta
        return False
    back = smooth | {"r": smooth["v_y"], "v_y": smooth["r"]}
    (small, here), (large, there) = (_asked(each, wheelbase, drives)[:2] for each in (smooth, back))
    follows = there > _FOLLOWS and abs(here) < _AGREE and large > abs(small)
    return follows and _slips(back, drives)[1] > _TIED
