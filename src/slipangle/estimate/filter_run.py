"""What came out of a record that a filter went over."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from slipangle.errors import ParameterError, nearest
from slipangle.shown import Brief


@dataclass(frozen=True)
class FilterRun(Brief):
    """How a filter went over a record: time [s], shape (n_samples,), and a row per sample, a column per name.

    States and parameters (SI units) are those after each sample, with their standard deviations. The error is the
    measured minus predicted output before the sample was taken in, with its standard deviation; NaN where the output
    was not measured. `taken` says which outputs were measured and no outliers; `biases` are the offsets of the sensors
    that `biased` names.
    """

    t: np.ndarray
    state_names: tuple[str, ...]
    states: np.ndarray  # after each sample, shape (n_samples, n_states), SI units
    states_std: np.ndarray  # of those
    free: tuple[str, ...]  # names of the parameters that are estimated
    parameters: np.ndarray  # after each sample, shape (n_samples, n_free), SI units
    parameters_std: np.ndarray  # of those
    outputs: tuple[str, ...]
    error: np.ndarray  # measured minus predicted, shape (n_samples, n_outputs)
    error_std: np.ndarray  # of those
    taken: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))
    biased: tuple[str, ...] = ()
    biases: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    biases_std: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))  # of the biases

    def parameter(self, name: str) -> np.ndarray:
        """One parameter over time, shape (n_samples,), in its SI unit.

        Raises ParameterError if it was not free.
        """
        if name not in self.free:
            raise ParameterError(f"'{name}' was not free; {nearest(name, self.free)}: use one of these")
        return self.parameters[:, self.free.index(name)]
