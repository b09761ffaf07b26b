"""Phases one behind the other as one problem that every solver takes.

Each phase is a problem of its own, with its model, weights, limits and horizon. They share the places of states, inputs
and exogenous columns; columns of the reference say which phase a stage belongs to. Between two phases a stage without
time, a jump, makes the first state of the next one from the last of the one before. The functions of the phases that a
stage does not belong to are evaluated where they do no harm, and count nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property
from typing import Any
from uuid import uuid4

import casadi as ca
import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.model import Model
from slipangle.ops import Vector, is_symbolic
from slipangle.optimal.guess import Guess
from slipangle.optimal.joined import FLAT, Joined
from slipangle.optimal.ocp import OCP, Reference, at_nodes
from slipangle.optimal.solution import finite, within
from slipangle.optimal.terms import Weights

Link = Callable[[Vector], Any]
HARMLESS = 0.3, 0.1  # where functions of other phases are evaluated: this, and so much more for each further entry


class Places(Model):
    """Places of the states of all phases; what they mean hangs on the phase."""

    def __init__(self, count: int, dt: float) -> None:
        self.states, self.inputs, self.outputs, self.dt = tuple(f"@{i}" for i in range(count)), (), (), dt

    def initial_state(self, data: Dataset) -> np.ndarray:
        """None is known."""
        raise NotImplementedError

    def step(self, x: Vector, u: Vector) -> Vector:
        """None is known without a phase."""
        raise NotImplementedError

    def output(self, x: Vector, u: Vector) -> Vector:
        """None is known without a phase."""
        raise NotImplementedError


class Linked(OCP):
    """The one problem that several phases are; what solvers read of it.

    Attributes
    ----------
    bases, parts : tuple of OCP
        The phases as they were posed, and as solvers are given each alone.
    starts : array of int, shape (n_phases,)
        Nodes at which they begin.
    slots : tuple of list of int
        Of each phase, the places of its inputs among all.
    links : tuple of callable
        From each phase to the next.
    joints : list of int
        Stages at which they lie.
    """

    bases: tuple[OCP, ...]
    parts: tuple[OCP, ...]
    starts: np.ndarray
    slots: tuple[list[int], ...]
    links: tuple[Link, ...]
    joints: list[int]

    def __init__(self, bases: Sequence[OCP], links: Sequence[Link]) -> None:
        # Long: what the solvers read, once each.
        parts = tuple(Joined(b) if b.composed else b for b in bases)
        many, lengths = len(parts), np.array([p.horizon for p in parts])
        starts = np.concatenate([[0], np.cumsum(lengths + 1)[:-1]])
        total, joints = int(starts[-1] + lengths[-1]), (starts[1:] - 1).tolist()
        slots, names, bounds = _slots(bases, parts)
        inner = [int(start) + j for start, p in zip(starts, parts, strict=True) for j in p.jumps]
        width = max(len(p.exogenous) for p in parts)
        exogenous = (*(f"w{i}" for i in range(width)), *(f"phase {k}" for k in range(many)))
        node = np.arange(total + 1)
        self.__dict__.update(
            bases=tuple(bases),
            parts=parts,
            links=tuple(links),
            starts=starts,
            slots=slots,
            model=Places(max(p.model.n_states for p in parts), parts[0].dt),
            horizon=total,
            steps=None,
            controls=names,
            exogenous=(*exogenous, *(f"link {k}" for k in range(many - 1))),
            parameters=(),
            identity=uuid4().hex,
            scenarios=None,
            free={},
            duration=None,
            huber={},
            corridor=None,
            terminal=None,
            headings=None,
            S=Weights(any=1.0),
            joints=joints,
            jumps=tuple(sorted([*inner, *joints])),
            ends=starts + lengths,
            which=np.clip(np.searchsorted(starts, node, side="right") - 1, 0, None),
            references=tuple(f"p{i}" for i in range(max(len(p.references) for p in parts))),
            tracked=tuple(f"{k}: {n}" for k, p in enumerate(parts) for n in p.tracked),
            limited=tuple(f"{k}: {n}" for k, p in enumerate(parts) for n in p.limited),
            soft=tuple(f"{k}: {n}" for k, p in enumerate(parts) for n in p.soft),
            slack_weights=tuple(np.concatenate(w) for w in zip(*(p.slack_weights for p in parts), strict=True)),
            excess_counts=np.concatenate([p.excess_counts for p in parts]),
            input_bounds=bounds,
            later_x=node,
            later_u=node[:-1],
            _counts=(1.0, 1.0, 1.0),
        )
        self.__dict__["limited_along"] = np.ones(len(self.limited), dtype=bool)
        at = np.zeros((total + 1, len(self.limited)), dtype=bool)
        for k, (rows, columns) in enumerate(zip(self._rows, self._columns("limited"), strict=True)):
            at[rows, columns] = parts[k].limited_at
        self.__dict__["limited_at"], self.__dict__["limited_now"] = at, at[0]
        self.__dict__["step_bounds"] = self._rates()
        self.__dict__["limits_at_nodes"] = self._limits([p.limits_at_nodes for p in parts])
        self.__dict__["stage_weights"] = self._weights([p.stage_weights for p in parts])

    # ---- places ------------------------------------------------------------------------------------------------

    @property
    def _rows(self) -> list[slice]:
        """Nodes of each phase."""
        return [slice(int(a), int(a) + p.horizon + 1) for a, p in zip(self.starts, self.parts, strict=True)]

    def _columns(self, what: str) -> list[slice]:
        """Of names that phases have one behind the other, those of each."""
        ends = np.cumsum([len(getattr(p, what)) for p in self.parts]).tolist()
        return [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]

    def _known(self, k: int) -> list[int]:
        """Slots of the inputs of a phase that the one before had too; none in the first."""
        return [i for i in self.slots[k] if i in self.slots[k - 1]] if k else []

    def _rates(self) -> np.ndarray:
        """Limits of changes: inputs stay as they were over a jump, and are new where the phase before had none.

        Over a junction they count over the time between the middles of its two stages, unless a duration is decided.
        """
        rates = np.full((self.horizon, len(self.controls), 2), [-np.inf, np.inf])
        for k, part in enumerate(self.parts):
            start, own, known = int(self.starts[k]), self.slots[k], self._known(k)
            rates[start : start + part.horizon, own] = part.step_bounds
            if k:
                new = [i for i in own if i not in known]
                lead = len([j for j in part.jumps if j == 0])
                rates[start : start + 1 + lead, new] = -np.inf, np.inf
                before, now = self.bases[k - 1 : k + 1]
                if before.duration is None and now.duration is None:
                    rates[start + lead, known] *= 0.5 * (before.dt + now.dt) / now.dt
                rates[start - 1, self.slots[k - 1]] = 0.0
                rates[start : start + lead, known] = 0.0
        return rates

    def _limits(self, given: Sequence[np.ndarray]) -> np.ndarray:
        limits = np.full((self.horizon + 1, len(self.limited), 2), [-np.inf, np.inf])
        for rows, columns, own in zip(self._rows, self._columns("limited"), given, strict=True):
            limits[rows, columns] = own
        limits[~self.limited_at] = -np.inf, np.inf
        return limits

    def _weights(self, given: Sequence[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weights of all; of inputs without effect those that keep them where they are, at no cost."""
        low, high = self.input_bounds.T
        with np.errstate(invalid="ignore"):
            half = 0.5 * (high - low)
        flat = FLAT / np.where(np.isfinite(half) & (half > 0), half, 1.0) ** 2
        of_q = np.zeros((self.horizon + 1, len(self.tracked)))
        of_r, of_s = np.tile(flat, (self.horizon, 1)), np.zeros((self.horizon, len(self.controls)))
        for k, (q, r, s) in enumerate(given):
            start, own, known = int(self.starts[k]), self.slots[k], self._known(k)
            stages = slice(start, start + self.parts[k].horizon)
            of_q[self._rows[k], self._columns("tracked")[k]] = q
            of_r[stages, own], of_s[stages, own] = r, s
            if k:
                new = [i for i in own if i not in known]
                lead = len([j for j in self.parts[k].jumps if j == 0])
                of_s[start : start + 1 + lead, new] = 0.0
                still = [(start - 1, self.slots[k - 1]), *((start + i, known) for i in range(lead))]
                for stage, tied in still:
                    of_r[stage, tied], of_s[stage, tied] = 0.0, flat[tied]
        return of_q, of_r, of_s

    # ---- functions ---------------------------------------------------------------------------------------------

    def _apart(self, k: int, kind: Any, x: Any, u: Any, w: Any, p: Any = None) -> list[Any]:  # type: ignore[override]
        """Arguments of a phase's functions: its own in its stages, elsewhere numbers that do no harm."""
        part = self.parts[k]
        here = w[self.exogenous.index(f"phase {k}")]
        own = [x[: part.model.n_states], u[self.slots[k]], w[: len(part.exogenous)]]
        own += [] if p is None else [p[: len(part.references)]]
        return [
            ca.if_else(here, v, ca.DM(HARMLESS[0] + HARMLESS[1] * np.arange(v.shape[0]))) if v.shape[0] else v
            for v in own
        ]

    def _chosen(self, w: Any, which: str, k: int, value: Any) -> Any:
        """A value in the stages that it belongs to, else zero."""
        return ca.if_else(w[self.exogenous.index(f"{which} {k}")], value, ca.DM.zeros(value.shape))

    def _padded(self, state: Any) -> Any:
        missing = self.model.n_states - state.shape[0]
        return ca.vertcat(state, ca.DM.zeros(missing, 1)) if missing else state

    @property
    def _kind(self) -> Any:
        functions = [f for p in self.parts for f in (p.dynamics, p.stage)]
        return ca.SX if all(f.is_a("SXFunction") for f in functions) else ca.MX

    @cached_property
    def dynamics(self) -> ca.Function:  # type: ignore[override]
        """``(x, u, w) -> x`` one step of the phase's model later."""
        kind = self._kind
        x, u, w, _, _ = self.symbols(kind)
        later = sum(
            self._chosen(w, "phase", k, self._padded(part.dynamics(*self._apart(k, kind, x, u, w))))
            for k, part in enumerate(self.parts)
        )
        return ca.Function("dynamics", [x, u, w], [ca.densify(later)], ["x", "u", "w"], ["next"])

    @cached_property
    def stage(self) -> ca.Function:  # type: ignore[override]
        """``(x, u, w, p) -> errors of `tracked`, values of `limited```, of which other phases' are zero."""
        kind = self._kind
        x, u, w, _, p = self.symbols(kind)
        found = [part.stage(*self._apart(k, kind, x, u, w, p)) for k, part in enumerate(self.parts)]
        error, limited = (
            ca.vertcat(*(self._chosen(w, "phase", k, pair[i]) for k, pair in enumerate(found))) for i in (0, 1)
        )
        return ca.Function("stage", [x, u, w, p], [error, limited], ["x", "u", "w", "p"], ["error", "limited"])

    @cached_property
    def jump(self) -> ca.Function:  # type: ignore[override]
        """``(x, u, w) -> x`` after a stage that takes no time: between phases, or in front of one."""
        x, u, w, _, _ = self.symbols(ca.SX)
        later = ca.SX.zeros(self.model.n_states)
        for k, part in enumerate(self.parts):
            inside = self._apart(k, ca.SX, x, u, w)
            linked = sum((w[self.exogenous.index(f"link {j}")] for j in range(len(self.links))), 0.0)
            if part.jump is not None and part.jumps:
                moved = self._chosen(w, "phase", k, self._padded(part.jump(*inside)))
                later = later + ca.if_else(linked, 0.0, moved)
            if k < len(self.links):
                later = later + self._chosen(w, "link", k, self._padded(self._linked(k, inside[0])))
        return ca.Function("jump", [x, u, w], [ca.densify(later)])

    def _linked(self, k: int, x: Any) -> Any:
        """First state of the next phase.

        Raises
        ------
        ParameterError
            If the link is no function of the state that gives those of the next phase.
        """
        before, wanted = self.bases[k].model.states, self.bases[k + 1].model.states
        needs = (
            f"expected a function of the {len(before)} states {list(before)} that gives a list of the next phase's, "
            f"{list(wanted)}, by arithmetic and slipangle.ops, such as ops.sin and ops.where"
        )
        try:
            state = _stacked(self.links[k](x[: len(before)]))
        except Exception as error:
            said = str(error).strip().rpartition("\n")[2][:200]
            raise ParameterError(f"link {k} fails on symbols ({type(error).__name__}: {said}); {needs}") from error
        if state.numel() != len(wanted):
            raise ParameterError(f"link {k} gives {state.numel()} states; {needs}")
        x, number = ca.SX.sym("x", len(before)), None
        place = HARMLESS[0] + HARMLESS[1] * np.arange(len(before))
        with suppress(Exception):  # such as a function of CasADi's, that takes symbols alone
            number = np.array(self.links[k](place), dtype=float).ravel()
        if number is not None and np.isfinite(number).all():
            symbolic = np.array(ca.Function("link", [x], [_stacked(self.links[k](x))])(place)).ravel()
            if not np.allclose(symbolic, number, rtol=1e-9, atol=1e-12):
                raise ParameterError(f"link {k} fails on symbols ({symbolic} there, {number} on numbers); {needs}")
        return state

    # ---- references --------------------------------------------------------------------------------------------

    def spread(self, applied: np.ndarray, references: Sequence[Reference]) -> Reference:
        """What is wanted of each phase, from the input now on, shape (n_controls,) of all, for all stages."""
        n, width = self.horizon, len(self.exogenous) - len(self.parts) - len(self.links)
        w, wanted = np.zeros((n + 1, len(self.exogenous))), np.zeros((n + 1, len(self.references)))
        inputs, limits, weights = np.tile(applied, (n, 1)), [], []
        for k, (part, own, given) in enumerate(zip(self.parts, self.slots, references, strict=True)):
            if isinstance(part, Joined):
                before = applied[own[: len(self.bases[k].controls)]]
                given = part.spread(np.zeros(self.bases[k].model.n_states), before, given)
            rows = self._rows[k]
            w[rows, : len(part.exogenous)] = at_nodes(np.asarray(given.exogenous, dtype=float), part.horizon)
            w[rows, width + k] = 1.0
            wanted[rows, : len(part.references)] = given.tracked
            inputs[rows.start : rows.stop - 1, own] = 0.0 if given.inputs is None else given.inputs
            limits.append(part.state_bounds(given))
            weights.append(part.weights_for(given))
        for k, joint in enumerate(self.joints):
            w[joint, width + len(self.parts) + k] = 1.0
        q, r, s = self._weights(weights)
        return Reference(tracked=wanted, exogenous=w, inputs=inputs, limits=self._limits(limits), Q=q, R=r, S=s)

    def resting(
        self, applied: np.ndarray, references: Sequence[Reference], guesses: Sequence[Guess | None]
    ) -> np.ndarray:
        """Inputs to begin with: those of the first phase as applied before, others near zero, shape (n_controls,)."""
        u = np.zeros(len(self.controls))
        for k in reversed(range(len(self.parts))):
            part, base, own = self.parts[k], self.bases[k], guesses[k]
            if isinstance(part, Joined):
                u[self.slots[k]] = part.resting(np.zeros(len(base.controls)))
                once = self.slots[k][len(base.controls) :][: len(base.decided_once)]
                u[once] = part.guess(references[k], None if own is None else own.decided)
        u[self.slots[0][: len(applied)]] = applied
        return np.clip(u, *self.input_bounds.T)

    def begin(
        self, x: np.ndarray, applied: np.ndarray, w: np.ndarray, guesses: Sequence[Guess | None]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Inputs and states that a plan begins with, shapes (horizon, n_controls) and (horizon + 1, n_states).

        Inputs are held and states are those that they lead to, in phases with a guess what that says: its first state
        too, but in the first phase.

        Parameters
        ----------
        x : array
            State of the first phase now.
        applied : array, shape (n_controls,)
            As `resting` has it.
        w : array, shape (horizon + 1, n_exogenous)
            What is known of the stages.
        guesses : sequence of Guess or None
            One per phase.
        """
        u, states = np.tile(applied, (self.horizon, 1)), np.zeros((self.horizon + 1, self.model.n_states))
        states[0, : len(x)] = x
        for k, own in enumerate(guesses):
            base, start = self.bases[k], int(self.starts[k])
            first, end = start + self.parts[k].horizon - base.horizon, start + self.parts[k].horizon
            stages, n, slots = slice(first, end), base.model.n_states, self.slots[k][: len(base.controls)]
            if own is not None:
                given = own.inputs(u[first, slots], base.horizon)
                u[stages, slots] = within(given, u[first, slots], base.input_bounds, self.step_bounds[stages, slots])
                u[end:, slots] = u[end - 1, slots]
            self._roll_out(states, u, w, start, first)
            said = None if own is None else own.states_from(states[first, :n], keep=k > 0)
            if said is None:
                self._roll_out(states, u, w, first, end)
            else:
                states[first : end + 1] = states[first]
                states[first : end + 1, :n] = said
            self._roll_out(states, u, w, end, min(end + 1, self.horizon))
        return u, states

    def _roll_out(self, states: np.ndarray, u: np.ndarray, w: np.ndarray, first: int, end: int) -> None:
        """Fill in the states that inputs lead to after these stages; where they are no numbers, the ones before."""
        for i in range(first, end):
            after = self.jump if i in self.jumps else self.dynamics
            later = np.asarray(after(states[i], u[i], w[i])).ravel()
            states[i + 1] = later if finite(later) else states[i]


def _stacked(given: Any) -> Any:
    return given if is_symbolic(given) else ca.vertcat(*given)


def _slots(bases: Sequence[OCP], parts: Sequence[OCP]) -> tuple[tuple[list[int], ...], tuple[str, ...], np.ndarray]:
    """Places of the inputs of each phase; inputs of one name and one range have one place in all."""
    keys: dict[Any, int] = {}
    slots = []
    for k, (base, part) in enumerate(zip(bases, parts, strict=True)):
        own = []
        for j, name in enumerate(part.controls):
            low, high = part.input_bounds[j].tolist()
            key = (name, low, high, k if j >= len(base.controls) else -1)
            own.append(keys.setdefault(key, len(keys)))
        slots.append(own)
    bounds = np.array([[low, high] for _, low, high, _ in keys], dtype=float).reshape(-1, 2)
    return tuple(slots), tuple(f"{i}: {key[0]}" for i, key in enumerate(keys)), bounds
