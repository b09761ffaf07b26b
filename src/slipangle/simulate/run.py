"""`Run`: what happened in a closed loop, ready to be judged."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from slipangle.data.channels import STANDARD
from slipangle.errors import ParameterError, nearest
from slipangle.models.model import Model
from slipangle.optimal.solution import Plan, Status, count
from slipangle.paths.path import Path
from slipangle.shown import Shown

SIDE = 0.5  # m, from a path without lanes


class End(Enum):
    """Why a drive ended."""

    FINISHED = "the end of the path was reached"
    TIME = "the given duration was over"
    LEFT_PATH = "the vehicle went too far from the path"
    NOT_FINITE = "the plant's state left the finite numbers"


@dataclass(frozen=True, kw_only=True, eq=False)
class Run(Shown):
    """A closed-loop drive, sampled at ``t`` [s], shape (n,).

    Parameters
    ----------
    states, inputs : array, shape (n, n_states), (n, n_inputs)
        True states of the plant, and inputs that acted on it, after delay and lag; their names stand beside them.
    path, s, reference
        What was to be followed, the arc length of its nearest point, shape (n,) [m], and X, Y [m], psi [rad], v_x [m/s]
        there, shape (n, 4).
    e_y, e_psi, v_x : array, shape (n,)
        Distance of the centre of gravity from the path, positive to its left [m]; heading minus the path's, between -pi
        and pi [rad]; speed [m/s].
    t_plan, plans, controls
        Time of each plan [s], shape (n_plans,), what the controller wanted, and the inputs that it decides.
    end, width
        Why the drive ended; the vehicle's width, for `inside`. [m]
    """

    t: np.ndarray
    state_names: tuple[str, ...]
    states: np.ndarray
    input_names: tuple[str, ...]
    inputs: np.ndarray
    path: Path
    width: float = 0.0
    s: np.ndarray
    reference: np.ndarray
    e_y: np.ndarray
    e_psi: np.ndarray
    v_x: np.ndarray
    plans: tuple[Plan, ...]
    t_plan: np.ndarray
    controls: tuple[str, ...]
    end: End

    def _words(self) -> str:
        lanes = "inside its lanes" if self.marked else "where no lanes are marked"
        where = lanes if self.inside else "outside its lanes"
        return f"{self.t[-1] - self.t[0]:.4g} s, {where}, {self.rmse('y'):.3g} m (RMS) from the path; {self.end.value}"

    def __getitem__(self, name: str) -> np.ndarray:
        """Samples of a state or input of the plant, or of a path error, shape (n,).

        Raises ParameterError if there is none of that name; the nearest names are given.
        """
        if name in self.state_names:
            return self.states[:, self.state_names.index(name)]
        if name in self.input_names:
            return self.inputs[:, self.input_names.index(name)]
        derived = {"s": self.s, "e_y": self.e_y, "e_psi": self.e_psi, "v_x": self.v_x, "e_v": self.e_v}
        if name in derived:
            return derived[name]
        known = (*self.state_names, *self.input_names, *derived)
        raise ParameterError(f"the run has no channel '{name}'; {nearest(name, known)}: use one of these names")

    @property
    def e_v(self) -> np.ndarray:
        """Speed minus the path's, shape (n,). [m/s]"""
        return self.v_x - self.reference[:, 3]

    def error(self, name: str) -> np.ndarray:
        """Tracking error: ``"y"`` across the path [m], ``"psi"`` in heading [rad], ``"v_x"`` in speed [m/s].

        Raises ParameterError if there is no such error.
        """
        errors = {"y": self.e_y, "psi": self.e_psi, "v_x": self.e_v}
        if name not in errors:
            raise ParameterError(f"there is no tracking error '{name}'; {nearest(name, errors)}: use one of these")
        return errors[name]

    def rmse(self, name: str = "y") -> float:
        """Root mean square of a tracking error, see `error`. [m, rad or m/s]"""
        return float(np.sqrt(np.mean(self.error(name) ** 2)))

    def max(self, name: str = "y") -> float:
        """Largest magnitude of a tracking error, see `error`. [m, rad or m/s]"""
        return float(np.abs(self.error(name)).max())

    @property
    def inside(self) -> bool:
        """Whether the vehicle's width stayed between the edges of the lane wherever they are marked.

        Not so of a drive that ended too far from the path, or whose state left the finite numbers.
        """
        if self.end in (End.LEFT_PATH, End.NOT_FINITE):
            return False
        lane = self.path.at(self.s)
        half = 0.5 * self.width
        return bool(np.all((self.e_y + half <= lane.left) & (self.e_y - half >= -lane.right)))

    @property
    def marked(self) -> bool:
        """Whether an edge of the lane is marked anywhere along the drive."""
        return self.path.at(self.s).marked

    @property
    def kept(self) -> bool:
        """Whether the end of the path was reached `inside` the lanes or, without any, at most `SIDE` from the path."""
        return self.finished and (self.inside if self.marked else self.max("y") <= SIDE)

    @property
    def finished(self) -> bool:
        """Whether the end of the path was reached: a car that stands still stays in its lanes too."""
        return self.end is End.FINISHED

    @property
    def commands(self) -> np.ndarray:
        """First inputs of the plans, shape (n_plans, n_controls)."""
        return np.array([p.command for p in self.plans]).reshape(len(self.plans), len(self.controls))

    @property
    def seconds(self) -> np.ndarray:
        """Wall time of each plan, shape (n_plans,). [s]"""
        return np.array([p.seconds for p in self.plans])

    @property
    def warm_seconds(self) -> np.ndarray:
        """The same without the first plan, which starts cold; of a single plan its own. [s]"""
        return self.seconds[1:] if len(self.plans) > 1 else self.seconds

    @property
    def statuses(self) -> dict[Status, int]:
        """How often each solver status occurred."""
        return count(self.plans)

    def beyond(self, model: Model) -> tuple[str, ...]:
        """What of the drive, and of what its plans foresee, lies outside of the data that a model learned from.

        One sentence each, none where nothing is to be said or the model has no `Model.region`. Of plans, the controls
        and those outputs count that are states of the plans, at the speed of their beginning.

        Parameters
        ----------
        model : Model
            That the controller plans with.
        """
        region, found = model.region, []
        if region is None:
            return ()
        driven = {n: self[n] for n in region.channels if n in (*self.state_names, *self.input_names, "v_x")}
        runs = [("drive", driven, self.t), ("motion that its plans foresee", *self._foreseen(model))]
        for what, channels, t in runs:
            if len(t):
                found.append(
                    region.left(channels, t=t, what=what, unit=lambda n: STANDARD[n].unit if n in STANDARD else "-")
                )
        return tuple(left.sentence for left in found if left is not None)

    def _foreseen(self, model: Model) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Channels of all fresh plans over their horizons, one plan after the other, and the times they are for. [s]"""
        fresh = [
            (p, t) for p, t in zip(self.plans, self.t_plan, strict=True) if p.age == 0 and len(p.x) == len(p.u) + 1
        ]
        if not fresh:
            return {}, np.empty(0)
        u, x = (np.array([rows(p) for p, _ in fresh]) for rows in (lambda p: p.u, lambda p: p.x[:-1]))
        shape, states = u.shape[:2], model.states
        began = np.interp([t for _, t in fresh], self.t, self.v_x)
        there = {"v_x": np.repeat(began[:, None], shape[1], axis=1)}
        places = {n: next((states.index(s) for s in (n, f"{n}[k]") if s in states), None) for n in model.outputs}
        there |= {n: x[:, :, i] for n, i in places.items() if i is not None}
        there |= {n: u[:, :, i] for i, n in enumerate(self.controls)}
        ahead = [t + (np.zeros(shape[1]) if p.times is None else p.times[: shape[1]]) for p, t in fresh]
        return {n: values.ravel() for n, values in there.items()}, np.concatenate(ahead)

    @property
    def fallbacks(self) -> int:
        """Steps at which the command did not come from a fresh plan."""
        return sum(p.age > 0 for p in self.plans)
