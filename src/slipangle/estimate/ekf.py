"""States that nobody measures, and parameters, one sample at a time: an extended Kalman filter for any model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.estimate.filter import parametrised
from slipangle.estimate.filter_run import FilterRun as FilterRun
from slipangle.estimate.recursive import RecursiveVehicle
from slipangle.fields import Checked, Count, Within
from slipangle.identify.excitation import require_identifiable
from slipangle.models.model import Model
from slipangle.models.provenance import provenance
from slipangle.optimal.terms import require_names

M = TypeVar("M", bound=Model)
Std = Annotated[float, Within(0, open="both")]
Size = Annotated[float, Within(0, open="high")]
POSE_STD = {"X": 0.02, "Y": 0.02, "psi": 0.002}  # m, m, rad: noise of a good positioning system


@dataclass(frozen=True, kw_only=True)
class EKF(Checked, Generic[M]):
    """Extended Kalman filter for the states of any model, and for some of its parameters. [1]_ sec. 8.3, [2]_ ch. 8.

    The model may be an ODE, plain or behind a delay, on the ground, a black box or a hybrid. Parameters join the state
    as random walks: a positive one by its logarithm, another as it is; both stay inside the range that its parameter
    set gives. With no free parameter it is a state observer, such as of side slip. Offsets of sensors join as random
    walks too. `start_at` gives a `RecursiveVehicle` that takes one sample at a time, `begin` one that takes channels by
    name, as a loop has them; `fit` runs through a whole record.

    Raises ParameterError if a name is unknown, a measured output has no noise, or a number is not positive.

    Parameters
    ----------
    start : Model
        Model with the start values; its outputs are what is measured.
    free : tuple of str
        Names of the parameters to estimate; none for a pure observer.
    noise_std : mapping of str to float
        Standard deviation of each output's measurement noise, in the output's unit; by default that of the residuals of
        the model's fit, and for X, Y, psi 0.02 m and 0.002 rad.
    process_std, walk_std : mapping of str to float
        Standard deviation, per root of a second, by which a state wanders off the model, and by which a parameter
        wanders (relative for a positive one, else in its unit); 0 for the others.
    prior_std, state_std : mapping of str to float
        Standard deviation at the start: of a parameter, relative for a positive one (0.3 unless given), else in its
        unit (a sixth of its range unless given); of a state at the start of an experiment, in its unit (the noise of
        the output of that name, else 1, unless given).
    bias_std, bias_walk : mapping of str to float
        Outputs whose sensor has an offset to be estimated, each with the standard deviation of that at the start; and
        by how much it wanders per root of a second, 0 unless given. In the output's unit.
    gate : float, optional
        An output that is off its prediction by more than so many standard deviations is an outlier and not taken in.
        Of the squares of sound ones, chi-square of one degree of freedom, 5 leaves out one in 1.7e6, 6 one in 5e8.
    patience : int
        After so many outliers of an output in a row, all on the same side of the prediction, the filter is taken to be
        wrong and not the sensor: the output is believed until it is no outlier any more.
    late : mapping of str to float
        How long after its instant an output arrives [s], to the nearest sample: it is taken in where it belongs, and
        the samples since then again.

    References
    ----------
    .. [1] B. D. O. Anderson, J. B. Moore, Optimal Filtering, 1979.
    .. [2] D. Simon, Optimal State Estimation, 2006: the update of one output at a time.
    """

    start: M
    free: tuple[str, ...] = ()
    noise_std: Mapping[str, Std] = field(default_factory=dict)
    process_std: Mapping[str, Size] = field(default_factory=dict)
    walk_std: Mapping[str, Size] = field(default_factory=dict)
    prior_std: Mapping[str, Std] = field(default_factory=dict)
    state_std: Mapping[str, Size] = field(default_factory=dict)
    bias_std: Mapping[str, Std] = field(default_factory=dict)
    bias_walk: Mapping[str, Size] = field(default_factory=dict)
    gate: Std | None = None
    patience: Count = 10
    late: Mapping[str, Size] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.free:
            parametrised(self.start).si(name)
        states, outputs = self.start.states, self.start.outputs
        known = {"noise_std": outputs, "walk_std": self.free, "prior_std": self.free, "bias_std": outputs}
        known |= {"process_std": states, "state_std": states, "bias_walk": tuple(self.bias_std), "late": outputs}
        for key, names in known.items():
            require_names(getattr(self, key), names, key)
        for name in outputs:
            if not self.noise(name) > 0:
                raise ParameterError(
                    f"noise_std lacks the measured output '{name}'; expected its noise: give noise_std['{name}'] in "
                    "the output's unit"
                )

    def noise(self, name: str) -> float:
        """Standard deviation of one output's noise, in its unit; 0 where nothing tells it."""
        if name in self.noise_std:
            return self.noise_std[name]
        inner = self.start.off_ground
        info = inner.fit_info
        if info is not None and name in inner.outputs and len(info.noise_std) == inner.n_outputs:
            return float(info.noise_std[inner.outputs.index(name)])
        return POSE_STD.get(name, 0.0)

    @property
    def begun(self) -> dict[str, int]:
        """Outputs that are a state as it stands and, once it began at one, are used up; the number of each one's state.

        Its standard deviation is then the output's noise: to take the same measurement in again would halve the
        variance. Those whose `state_std` is given, or whose sensor has an offset, are not among them.
        """
        plain = [n.removeprefix("base ").removesuffix("[k]") for n in self.start.states]
        at = {name: plain.index(name) for name in self.start.outputs if name in plain and name not in self.bias_std}
        return {name: i for name, i in at.items() if self.start.states[i] not in self.state_std}

    @property
    def model(self) -> M:
        """The model whose state is estimated."""
        return self.start

    @property
    def dt(self) -> float:
        """Time between samples. [s]"""
        return self.start.dt

    def begin(self, measured: Mapping[str, float]) -> RecursiveVehicle:
        """A filter before its first sample, where channels by name say what the state is about; see `take`."""
        tracker = RecursiveVehicle(self)
        tracker.begin(measured)
        return tracker

    def start_at(self, x0: np.ndarray | None = None) -> RecursiveVehicle:
        """A filter before its first sample; ``x0``, shape (n_states,), is the state expected there, by default zero."""
        tracker = RecursiveVehicle(self)
        tracker.restart(x0)
        return tracker

    def export(self, folder: str | Path, **settings: Any) -> Path:
        """Write the filter as C that runs without Python; see `slipangle.export.export`, also for its settings.

        Raises ParameterError if there is no C of it, WriteError if the folder is not empty or cannot be written.
        """
        return import_module("slipangle.export").export(self, folder, **settings)  # a room above this one

    def fit(self, data: Dataset) -> M:
        """The model with the parameters after the last sample of ``data``, their covariance in its ``fit_info``.

        Errors are those of `slipangle.identify.physics.grey_box.GreyBox`; SimulationError if the filter diverged.
        """
        chosen = data.select(inputs=self.start.inputs, outputs=self.start.outputs)
        require_identifiable(chosen, max(1, len(self.free)), scheduling=("v_x",))
        estimate = self.start_at()
        estimate.run(data)
        return estimate.model(**{"train_name": data.name, **provenance(chosen)})
