"""Several models as one: the mean of their outputs, and how far they disagree."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from math import isclose

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.hybrid import run_up
from slipangle.models.model import FitInfo, Model
from slipangle.ops import Vector, concatenate


@dataclass(frozen=True, kw_only=True)
class EnsembleModel(Model):
    """Models of the same channels side by side; the output is the mean of theirs.

    Each member keeps a state of its own. A measurement shifts every member by the error of the mean, so their
    disagreement survives it.

    Parameters
    ----------
    members : tuple of Model
        At least one; inputs, outputs and sample time alike.

    Raises
    ------
    ParameterError
        If there is none, or they differ.
    """

    members: tuple[Model, ...]
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))
        if not self.members:
            raise ParameterError("the ensemble has no member; expected at least one model")
        first = self.members[0]
        for k, other in enumerate(self.members):
            alike = (other.inputs, other.outputs) == (first.inputs, first.outputs)
            if not alike or not isclose(other.dt, first.dt, rel_tol=1e-6):
                raise ParameterError(
                    f"member {k} maps {other.inputs} to {other.outputs} at {other.dt:g} s, the first {first.inputs} to "
                    f"{first.outputs} at {first.dt:g} s; expected the same of all"
                )

    @property
    def dt(self) -> float:  # type: ignore[override]
        """Sample time. [s]"""
        return self.members[0].dt

    @property
    def inputs(self) -> tuple[str, ...]:  # type: ignore[override]
        """Of every member."""
        return self.members[0].inputs

    @property
    def outputs(self) -> tuple[str, ...]:  # type: ignore[override]
        """Of every member."""
        return self.members[0].outputs

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """Every member's, numbered."""
        return tuple(f"{k}: {name}" for k, member in enumerate(self.members) for name in member.states)

    @property
    def memory(self) -> int:  # type: ignore[override]
        """The longest of the members'."""
        return max(member.memory for member in self.members)

    def _pieces(self, x: Vector) -> list[Vector]:
        edges = np.cumsum([0, *(member.n_states for member in self.members)])
        return [x[a:b] for a, b in pairwise(edges.tolist())]

    def step(self, x: Vector, u: Vector) -> Vector:
        """Every member a sample further."""
        return concatenate([m.step(piece, u) for m, piece in zip(self.members, self._pieces(x), strict=True)])

    def output(self, x: Vector, u: Vector) -> Vector:
        """Mean of the members' outputs."""
        outputs = [m.output(piece, u) for m, piece in zip(self.members, self._pieces(x), strict=True)]
        total = outputs[0]
        for y in outputs[1:]:
            total = total + y
        return total / len(outputs)

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """Every member corrected by the error of the mean."""
        error = y - self.output(x, u)
        pairs = zip(self.members, self._pieces(x), strict=True)
        return concatenate([m.correct(piece, u, m.output(piece, u) + error) for m, piece in pairs])

    def initial_state(self, data: Dataset) -> np.ndarray:
        """Every member's, run up to the last sample."""
        return np.concatenate([run_up(member, data)[0] for member in self.members])

    def spread(self, data: Dataset) -> np.ndarray:
        """Standard deviation of the members' free runs, shape (n_samples, n_outputs); zero before they start."""
        runs = np.stack([member.simulate(data).y for member in self.members])
        return runs.std(axis=0, ddof=1) if len(runs) > 1 else np.zeros(runs.shape[1:])
