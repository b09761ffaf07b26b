"""`identify_car`: from a log to a car with its steering, its sensors and what the log cannot say."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.data.quality.plausible import LONGEST_STEP, TURNED, doubts, kinematic_gain
from slipangle.data.quality.slow_motion import zero_of_r
from slipangle.data.quality.smooth import smoothed
from slipangle.errors import (
    IdentifiabilityWarning,
    MissingColumnError,
    ModelWarning,
    ParameterError,
    SampleTimeError,
)
from slipangle.fields import Checked
from slipangle.identify.car import play, sentences
from slipangle.identify.car.climb import climb, linear_bicycle
from slipangle.identify.car.corrections import SLIDES, Correction, corrections, friction_used
from slipangle.identify.car.effects import believed, in_words, others_as_good
from slipangle.identify.car.late import beside, with_lateness
from slipangle.identify.car.logged_speed import following
from slipangle.identify.car.moved_zero import put_back, with_zeros
from slipangle.identify.car.rack import with_rack
from slipangle.identify.car.rear_wheels import doubts_with_rear
from slipangle.identify.car.recordings import settled
from slipangle.identify.car.sensors import scales, sensors
from slipangle.identify.car.side_slip import side_slip
from slipangle.identify.car.stretches import Stretches, stretches, together
from slipangle.identify.car.structures import (
    ADDED,
    STIFF,
    Fitted,
    Others,
    Stage,
    first_guess,
    fit,
)
from slipangle.identify.car.widened import SMALL, limits_of, too_coarse
from slipangle.identify.physics.at_the_limit import Gain, Mass, ToFrontAxle, Wheelbase
from slipangle.models.model import ProfileInfo
from slipangle.models.provenance import provenance
from slipangle.models.vehicles.parameters import weight_doubt
from slipangle.models.wrappers.delayed import Delayed
from slipangle.numerics.blas import one_blas_thread
from slipangle.shown import Shown

_NEAR = 0.45, 2.5  # gain that a log shows over the given one, between which a fit finds its way from the given one
_SMALL_ALONE = 0.35  # rad, as `SMALL`, of a log of the yaw rate alone; their tangent is a twentieth more
_LEAST_GAIN = 1e-4  # of the steering; 1/57 where degrees were logged behind a ratio of 60
_OWN = (
    *("steering_offset", "bias_r", "bias_v_y", "bias_a_y", "cross_slope"),
    *("delay_delta", "steering_gain", "lever_v_y", "mass"),
)


@dataclass(frozen=True, kw_only=True)
class IdentifiedCar(Shown):
    """What `identify_car` found: the model, how it came about, and what to know of it, in words."""

    model: Any  # with its `FitInfo`
    stages: tuple[Stage, ...]  # what was added one after the other, and what each changed
    doubts: tuple[str, ...]  # of the log and of what was said of the car
    sentences: tuple[str, ...]  # those doubts, what each correction changed, and what the log cannot say
    separated: Mapping[str, bool]  # whether C_f, C_r and inertia_z have values of their own

    def interval(self, name: str) -> tuple[float, float]:
        """95 % interval of a parameter, SI units.

        Raises
        ------
        ParameterError
            If the parameter was not estimated.
        """
        info = self.model.fit_info
        if name not in info.names:
            raise ParameterError(f"'{name}' was not estimated; expected one of {', '.join(info.names)}")
        low, high = info.interval()[info.names.index(name)]
        return float(low), float(high)

    def for_recording(self, data: Dataset, seconds: float = 30.0) -> Delayed:
        """The model for a recording that it was not fitted to: what differs between recordings, from its first seconds.

        Stiffness and all else that recordings share stay. What differs is drawn to the mean of the recordings that were
        fitted to, as hard as these differ among themselves; judge the model on what comes after these seconds. It comes
        back as it is where nothing differs. ``model.for_experiment(k)`` is that of a recording of the fit.

        Parameters
        ----------
        data : Dataset
            With the channels that the model was fitted to, at its sample time.
        seconds : float
            How much of it is used, of driving. [s]

        Raises TooShortError if the car moves for less than a tenth of that, SampleTimeError, MissingColumnError or
        ExcitationError if the recording is of another kind, or does not steer.
        """
        return settled(self.model, data, seconds)


@dataclass(frozen=True, kw_only=True)
class WholeCar(Checked):
    """`identify_car` as an estimator, for jobs and comparisons.

    Parameters
    ----------
    mass : float
        Of the car as it was driven. [kg]
    wheelbase : float
        From axle to axle. [m]
    l_f : float
        From the centre of gravity to the front axle. [m]
    steering_gain : float
        A first guess of the road-wheel angle per logged angle [-], such as 1/15 for a hand wheel; negative turns it.
    per_experiment : tuple of str or "chosen"
        Parameters with a value for each recording: of steering_offset, bias_r, bias_v_y, bias_a_y, cross_slope (of the
        road), delay_delta, steering_gain, lever_v_y and mass (the given one is that of the first). By default offset
        and biases are tried where there are several recordings of 40 s or more at the mean.
    """

    mass: Mass
    wheelbase: Wheelbase
    l_f: ToFrontAxle
    steering_gain: Gain = 1.0
    per_experiment: tuple[str, ...] | Literal["chosen"] = "chosen"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.l_f < self.wheelbase:
            raise ParameterError(
                f"l_f is {self.l_f:g} m and the wheelbase {self.wheelbase:g} m; expected the centre of gravity between "
                "the axles: check both, and their units"
            )
        if abs(self.steering_gain) < _LEAST_GAIN:
            raise ParameterError(
                f"steering_gain is {self.steering_gain:g}; expected at least {_LEAST_GAIN:g} either way, such as 1/15 "
                "for a hand wheel: with none the steering would turn no wheel"
            )
        unknown = [n for n in self._own or () if n not in _OWN]
        if unknown or len(set(self._own or ())) < len(self._own or ()):
            wrong = f"names '{unknown[0]}'" if unknown else "names a parameter twice"
            raise ParameterError(f"per_experiment {wrong}; expected each once, of {', '.join(_OWN)}")

    @property
    def _known(self) -> dict[str, float]:
        return {"mass": self.mass, "wheelbase": self.wheelbase, "l_f": self.l_f}

    @property
    def _own(self) -> tuple[str, ...] | None:
        """Parameters with a value for each recording; None where that is to be found out."""
        return None if isinstance(self.per_experiment, str) else tuple(self.per_experiment)

    def fit(self, data: Dataset) -> Delayed:
        """The model of the identified car; what there is to know of it stands in its `fit_info`.

        Warns with an IdentifiabilityWarning of what contradicts itself in the log and of what the log cannot say;
        what corrections changed is in ``fit_info.corrections``.
        """
        found = self.identify(data)
        for sentence in found.model.fit_info.warnings:
            warnings.warn(sentence, IdentifiabilityWarning, stacklevel=2)
        return found.model

    def identify(self, data: Dataset) -> IdentifiedCar:
        """See `identify_car`; raises MissingColumnError, SampleTimeError and the others named there."""
        began = time.perf_counter()
        self._check(data)
        turned = data.with_channel("delta", self.steering_gain * data["delta"], "rad")
        logged = data.select(inputs=("delta", "v_x", *(n for n in ADDED if n in data)), outputs=self._outputs(data))
        whole = stretches(smoothed(logged, "v_x"), self.wheelbase)  # an input's noise stands in for parameters
        weight = weight_doubt(self.mass, self.wheelbase)
        with one_blas_thread(), warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*" if weight else ".* hold the same samples", ModelWarning)
            linear, elsewhere = self._begin(turned, logged, whole)
            suspect = self._suspect(turned, linear, whole)
            search = partial(self._search, linear, elsewhere)
            (final, stages, dropped), whole, zeros = with_zeros(search, whole)
            others, mended = _others(final, dropped, whole.all)
            suspect = beside(mended, suspect)
            used = sentences.friction_reached(final)
            final, others = following(final, others, put_back(stretches(logged, self.wheelbase).all, zeros))
        names, (spread, limits, how) = final.names, limits_of(final, others, self._turned(whole.all))
        separated = sentences.separated(names, final, limits)
        odd = [*sentences.turning(final, self.steering_gain), *sentences.impossible(names, final, limits, used)]
        odd += sentences.misplaced(final, others, limits)
        left = [*sentences.held(mended, doubted=bool(suspect or odd)), *sentences.left_out(whole)]
        left += [*(zero.sentence for zero in zeros), *play.in_words(final, whole.all)]
        wrong = (*left, *suspect, *filter(None, [weight]), *sensors(final, spread), *odd)
        changed = [*sentences.changes(stages), *sentences.steering(final, others, limits)]
        unknown = (
            *sentences.ridges(names, final, spread, limits, separated),
            *too_coarse(final),
            *sentences.elsewhere(final, others),
            *sentences.speed(final, others),
            *scales(final, limits, turned),
            *sentences.between(final),
            *in_words(final, limits, used),
            *sentences.bounds(final, used),
            *sentences.unsettled(final),
        )
        info = ProfileInfo(
            names=names,
            values=np.array([final.values[n] for n in names]),
            covariance=spread,
            noise_std=final.sigma,
            n_samples=len(final.error),
            units=tuple(final.model.si(n).unit for n in final.problem.base_names),
            seconds=time.perf_counter() - began,
            method=f"free-run error, structure by held-out stretches; {how}, and {len(others)} structures as good; "
            f"C_f, C_r and inertia_z in proportion to the given mass of {self.mass:g} kg",
            warnings=(*wrong, *unknown),
            corrections=tuple(changed),
            limits=limits,
            **provenance(data),
        )
        return IdentifiedCar(
            model=replace(final.model, fit_info=info),
            stages=tuple(stages),
            doubts=wrong,
            sentences=(*wrong, *changed, *unknown, self._of_the_mass(sentences.acting(names, final, limits))),
            separated=separated,
        )

    def _begin(
        self, turned: Dataset, logged: Dataset, whole: Stretches
    ) -> tuple[Callable[[Dataset], Fitted], dict[str, float]]:
        """The fit of the linear bicycle to stretches, and where gain and bias start too."""
        how: Any = {"dt": logged.dt, "outputs": logged.outputs, "small_angles": self._turns_little(whole.all)}
        start = first_guess(**self._known, **how, gain=self.steering_gain, added=logged.inputs)
        elsewhere = self._elsewhere(start, turned)
        return partial(linear_bicycle, start, self._own or (), elsewhere), elsewhere

    def _search(
        self, linear: Callable[[Dataset], Fitted], elsewhere: dict[str, float], whole: Stretches
    ) -> tuple[Fitted, list[Stage], list[Correction]]:
        """The last fit, its stages, and the corrections that did not help."""
        tried = corrections(whole.train, self.wheelbase, self._own, elsewhere)
        best, stages, dropped = climb(linear(whole.train), tried, whole.train, whole.held_out)
        final = fit(best.model, best.free, whole.all, best, own=best.own, last=True)
        return *believed(final, stages, whole.all), dropped

    def _check(self, data: Dataset) -> None:
        """Raise MissingColumnError or SampleTimeError unless the data have the channels needed, often enough."""
        require_dataset(data, "fit() got")
        for name in ("delta", "v_x", "r"):
            if name not in data:
                raise MissingColumnError(
                    f"'{data.name}' has no channel '{name}'; expected delta, v_x and r at least: name the columns so "
                    "when reading the log"
                )
        if data.dt > LONGEST_STEP:
            raise SampleTimeError(doubts(data, wheelbase=self.wheelbase)[0])
        for name in self._own or ():
            channel = name.removeprefix("bias_").removeprefix("lever_")
            if channel in ("v_y", "a_y") and channel not in data.outputs:
                raise MissingColumnError(
                    f"per_experiment names '{name}', and '{data.name}' has no output {channel}; expected one"
                )

    def _suspect(self, data: Dataset, fitted: Callable[[Dataset], Fitted], whole: Stretches) -> tuple[str, ...]:
        """Sentences about channels that contradict each other, but for a v_y sensor that is turned, as fits mend it."""
        found = doubts_with_rear(data, self.wheelbase, fitted, whole)
        said = tuple(s for s in found if TURNED not in s or s.startswith("in recording"))
        return said if any("side slip angle" in s for s in said) else (*said, *side_slip(fitted, whole))

    def _outputs(self, data: Dataset) -> tuple[str, ...]:
        """The yaw rate, v_y where measured; a_y where v_y is not or its bias is asked for, see `identify_car`."""
        without_a_y = "v_y" in data.outputs and "bias_a_y" not in (self._own or ())
        measured = {"r", *data.outputs} - ({"a_y"} if without_a_y else set())
        return tuple(n for n in ("v_y", "r", "a_y") if n in measured)

    def _turns_little(self, data: Dataset) -> bool:
        """Whether the motion asks for small steering angles only; by the motion, as delta may be of a hand wheel.

        What turned wheels take of the front's force looks like bent tires and like load where the yaw rate is alone,
        and stands in for bent tires at the limit of grip before friction is free.
        """
        most = _SMALL_ALONE if {"v_y", "a_y"}.isdisjoint(data.outputs) else SMALL
        return "delta_r" in data or friction_used(data) > SLIDES or self._turned(data) < most

    def _turned(self, data: Dataset) -> float:
        """Steering angle that the motion asks for, at most. [rad]"""
        return float(np.quantile(np.abs(data["r"] * self.wheelbase / data["v_x"]), 0.99))

    def _elsewhere(self, start: Any, turned: Dataset) -> dict[str, float]:
        """Gain and offset of r that the log shows, where they are far from those given, with ordinary tires."""
        over, zero = (told(turned, wheelbase=self.wheelbase) for told in (kinematic_gain, zero_of_r))
        far = 0.0 if _NEAR[0] < over < _NEAR[1] else over * self.steering_gain
        there = {"steering_gain": far, "bias_r": zero}
        found = {n: float(np.clip(v, start.si(n).lower, start.si(n).upper)) for n, v in there.items() if v}
        return found | {name: start.value(name) for name in STIFF} if found else {}

    def _of_the_mass(self, moment: str) -> str:
        """What only scales can tell, or how a yaw moment acts, ``moment``, if that was logged."""
        check = f"which M_z can check as far as its own scale is known: it turns the car as {moment}"
        return (
            f"C_f, C_r and inertia_z are in proportion to the mass that was given, {self.mass:g} kg, "
            f"{check if moment else 'which no log of the motion can check'}: weigh the car as it was driven; C_f and "
            "C_r are in proportion to the square of the speed too, inertia_z to it: check v_x over a known distance"
        )


def identify_car(
    data: Dataset | Sequence[Dataset],
    *,
    mass: float,
    wheelbase: float,
    l_f: float,
    steering_gain: float = 1.0,
    per_experiment: tuple[str, ...] | Literal["chosen"] = "chosen",
) -> IdentifiedCar:
    """A car's parameters with intervals, its steering's delay and lag, its sensors' biases, from any log of it.

    From the linear bicycle with its steering's offset on, corrections are tried one after the other: the steering's
    delay and lag, its gain, saturation and the shape of its curve, the largest rate of a steering that is late, the
    sensors' biases and the place of that of v_y, relaxation of the tires, rear wheels that turn as one where v_y or
    a_y is fitted, downforce where fast driving is 1.4 times slow driving. Each stays if it is worth its parameters on
    three quarters of the log's stretches and does no harm on the held-out others; the last fit is to all of them.
    Saturation need not earn its parameters where the log reaches 0.6 of gravity, as every tire has it; biases, which
    are the same all the time, have to help on most held-out stretches. Where the zero of delta moves in mid log,
    it is put back. Where the car spins, the log is left out. Noise and steps of v_x, an input, are taken out for the
    fit. Intervals take in what stretches, and structures that explain the log about as well, disagree on.

    Parameters
    ----------
    data : Dataset or sequence of Dataset
        One log, or several of one car, each a recording with offsets of its own; the experiments of a single one count
        as recordings. With channels delta [rad] (as logged), v_x [m/s], r [rad/s]; axes of ISO 8855. Where v_y [m/s],
        or else a_y [m/s2] (as an accelerometer reads it), is among the outputs it is fitted too, and tells stiffness
        and inertia apart as the yaw rate alone can hardly do. Beside v_y, a_y is fitted where ``per_experiment`` names
        its bias only: the body's roll, which a single track lacks, is in it. Where there are channels delta_r [rad],
        M_z [N m] and bank [rad], they are the angle of steered rear wheels, the yaw moment of torque vectoring (times
        a scale that is found) and the road's cross slope, positive with the left edge higher, see `RearSteered`,
        `TorqueVectored` and `Banked`. Where the steering moves between the samples, `Dataset.hold_mean`
        first, here as for every later simulation.
    mass, wheelbase, l_f, steering_gain, per_experiment
        See `WholeCar`.

    Returns
    -------
    IdentifiedCar
        Its ``model`` is a ``Delayed(SaturatingBicycle)``, `Steered` in between where the steering is late, with
        `fit_info`; print its ``sentences``. ``C_f`` and ``C_r`` are those of axles: compliance, roll steer and aligning
        moments are in them.

    Raises MissingColumnError, ParameterError, SampleTimeError or TooShortError if a channel is missing, a number is
    impossible, time is in milliseconds, or the car hardly moves.
    """
    known: Any = {"mass": mass, "wheelbase": wheelbase, "l_f": l_f, "steering_gain": steering_gain}
    return WholeCar(**known, per_experiment=per_experiment).identify(together(data))


def _others(final: Fitted, dropped: list[Correction], data: Dataset) -> tuple[Others, list[str]]:
    """Structures as good, those of a log that is mended with them, and what is to be mended."""
    others, late = with_lateness(final, others_as_good(final, dropped, data), data)
    others, bent = with_rack(final, others, dropped, data)
    return others, [*late, *bent]
