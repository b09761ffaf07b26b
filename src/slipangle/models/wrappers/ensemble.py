"""Several models as one: the mean of their outputs, and how far they disagree."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from math import isclose

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.model import FitInfo, Model, derived, taken
from slipangle.models.wrappers.hybrid import run_up
from slipangle.ops import Vector, concatenate, stack


@dataclass(frozen=True, kw_only=True)
class EnsembleModel(Model):
    """Models of the same outputs side by side; the output is the mean of theirs.

    Each member keeps a state of its own and takes the inputs that it knows. A measurement shifts every member by the
    error of the mean, so their disagreement survives it. Raises ParameterError if there is none, or they differ.

    Parameters
    ----------
    members : tuple of Model
        At least one; outputs and sample time alike.
    """

    members: tuple[Model, ...]
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    dt = derived(lambda self: self.members[0].dt)
    outputs = derived(lambda self: self.members[0].outputs)
    inputs = derived(lambda self: tuple(dict.fromkeys(name for member in self.members for name in member.inputs)))
    states = derived(lambda self: tuple(f"{k}: {name}" for k, m in enumerate(self.members) for name in m.states))
    memory = derived(lambda self: max(member.memory for member in self.members))
    alternatives = taken("members")
    region = derived(lambda self: self.members[0].region)

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))
        if not self.members:
            raise ParameterError("the ensemble has no member; expected at least one model")
        first = self.members[0]
        for k, other in enumerate(self.members):
            if other.outputs != first.outputs or not isclose(other.dt, first.dt, rel_tol=1e-6):
                raise ParameterError(
                    f"member {k} predicts {other.outputs} at {other.dt:g} s, the first {first.outputs} at "
                    f"{first.dt:g} s; expected the same of all: fit them to the same data"
                )

    def _pieces(self, x: Vector, u: Vector) -> Iterator[tuple[Model, Vector, Vector]]:
        """Every member with its state and its inputs."""
        edges, inputs = np.cumsum([0, *(member.n_states for member in self.members)]), self.inputs
        for member, (a, b) in zip(self.members, pairwise(edges.tolist()), strict=True):
            own = u if member.inputs == inputs else stack([u[inputs.index(name)] for name in member.inputs])
            yield member, x[a:b], own

    def step(self, x: Vector, u: Vector) -> Vector:
        """Every member a sample further."""
        return concatenate([member.step(piece, own) for member, piece, own in self._pieces(x, u)])

    def output(self, x: Vector, u: Vector) -> Vector:
        """Mean of the members' outputs."""
        first, *others = (member.output(piece, own) for member, piece, own in self._pieces(x, u))
        return sum(others, first) / len(self.members)

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """Every member corrected by the error of the mean."""
        error = y - self.output(x, u)
        pieces = self._pieces(x, u)
        return concatenate([m.correct(piece, own, m.output(piece, own) + error) for m, piece, own in pieces])

    def initial_state(self, data: Dataset) -> np.ndarray:
        """Every member's, run up to the last sample."""
        return np.concatenate([run_up(member, data)[0] for member in self.members])
