"""`Phases`: several problems one behind the other, planned as one."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from time import perf_counter
from typing import Annotated, Any

import numpy as np

from slipangle.control.moved import moved
from slipangle.control.mpc import MPC
from slipangle.errors import ModelWarning, ParameterError
from slipangle.fields import Checked, Within
from slipangle.models.model import without_caches
from slipangle.numerics.per_thread import built
from slipangle.optimal.arrays import applied_input, short, vector
from slipangle.optimal.checks import is_number
from slipangle.optimal.engine import Engine, Start
from slipangle.optimal.guess import Guess
from slipangle.optimal.linked import Linked
from slipangle.optimal.named import backend_of, require_solver
from slipangle.optimal.ocp import OCP, Reference
from slipangle.optimal.setpoints import setpoint
from slipangle.optimal.solution import Plan, Solution, Status, finite, within
from slipangle.optimal.stretched import Finer
from slipangle.shown import Shown


@dataclass(frozen=True, kw_only=True, eq=False)
class PhasePlan:
    """What a plan does in one phase.

    Parameters
    ----------
    u : array, shape (horizon, n_controls)
        Decided inputs.
    x : array, shape (horizon + 1, n_states)
        Predicted states, the last one before the link to the next phase.
    times : array, shape (horizon + 1,)
        Their instants from now on. [s]
    controls, states : tuple of str
        Names of the columns.
    decided : dict of str to float
        What is decided once in the phase, its duration too; SI units.
    """

    u: np.ndarray
    x: np.ndarray
    times: np.ndarray
    controls: tuple[str, ...]
    states: tuple[str, ...]
    decided: dict[str, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class PhasedPlan(Shown):
    """Inputs and states of all phases.

    Parameters
    ----------
    phases : tuple of PhasePlan
        One behind the other.
    status : Status
        How the solver ended.
    cost : float
        Sum of the phases' costs, in the units of their weights.
    iterations : int
        Of the solver.
    seconds : float
        Wall time of the call. [s]
    violation : float
        Largest excess over any constraint, see `Plan`. [SI]
    residual : float
        Of the optimality conditions, see `Plan`. [-]
    age : int
        How many plans ago its inputs were found; 0 where they are of this one.
    """

    phases: tuple[PhasePlan, ...]
    status: Status
    cost: float
    iterations: int
    seconds: float
    violation: float
    residual: float
    start: Plan
    age: int = 0

    def _words(self) -> str:
        end, old = self.phases[-1].times[-1], f", {self.age} plans old" if self.age else ""
        return f"{len(self.phases)} phases{old}, {end:.4g} s ahead; {self.status.name} in {1e3 * self.seconds:.3g} ms"

    @property
    def command(self) -> np.ndarray:
        """The first input, shape (n_controls,) of the first phase."""
        return self.phases[0].u[0]


@dataclass(frozen=True, eq=False)
class Phases(Checked):
    """Several optimal control problems one behind the other, of different models too, solved as one.

    Each phase has its own model, horizon, weights, limits, Huber costs, free parameters and duration; the cost is the
    sum of theirs, in which the end of each counts by its ``terminal``. The state in which a phase begins is what a link
    makes of the last one before. Inputs of one name and one range go on from phase to phase: the first one of a phase
    counts by S and keeps the rates from the last one before.

    Where a plan `later` than the one before is not found, it is that one moved on, and its ``age`` says how old it is.
    Without one before there is no fallback: where ``plan.status.solved`` is false and ``plan.age`` zero, neither its
    inputs nor its states are an answer.

    Parameters
    ----------
    problems : sequence of MPC or OCP
        The phases, two or more; of controllers only the problem counts. No phase has scenarios, or stages of several
        steps.
    links : sequence of callable, optional
        ``link(x)`` for each junction: the state of the phase before, to that of the next, as a list; written with
        `slipangle.ops`. By default the next phase begins in the same state, which must then have the same names.
    solver : {"realtime", "ipopt"} or Backend
        The solver, or its settings.
    deadline : float, optional
        For a plan, by default none; one that ends by it is named `TIME_OUT`. [s]

    Raises
    ------
    ParameterError
        If there are fewer than two phases, or not a link for each junction, a phase has what it must not, or the
        deadline is no time.
    """

    problems: Sequence[MPC | OCP]
    links: Sequence[Callable[[Any], Any]] | None = None
    solver: Any = "realtime"
    deadline: Annotated[float, Within(0, unit="s", open="low")] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        given = list(self.problems) if isinstance(self.problems, Sequence) else []
        phases = tuple(p.ocp if isinstance(p, MPC) else p for p in given)
        if len(phases) < 2 or not all(isinstance(p, OCP) for p in phases):
            raise ParameterError(f"the phases are {short(self.problems)}; expected two or more MPC or OCP")
        for k, phase in enumerate(phases):
            if phase.scenarios is not None or phase.steps is not None:
                what = "scenarios" if phase.scenarios is not None else "stages of several steps"
                raise ParameterError(f"phase {k} has {what}; expected a problem without")
        for a, b in pairwise(phases):
            if self.links is None and a.model.states != b.model.states:
                raise ParameterError(
                    f"a phase ends with the states {list(a.model.states)} and the next begins with "
                    f"{list(b.model.states)}; expected links=[lambda x: [...]] from the first to the second"
                )
        links = [_same] * (len(phases) - 1) if self.links is None else self.links
        if not isinstance(links, Sequence) or len(links) != len(phases) - 1 or not all(map(callable, links)):
            raise ParameterError(
                f"links is {short(self.links)}{_many(self.links)}; expected a list of {len(phases) - 1} functions, one "
                "per junction, such as links=[lambda x: [...]]"
            )
        require_solver(self.solver)
        object.__setattr__(self, "problems", phases)
        object.__setattr__(self, "links", tuple(links))

    def __getstate__(self) -> dict[str, Any]:
        """What a copy needs, in this process or another: its settings, nothing compiled."""
        return without_caches(self)

    @built
    def _parts(self) -> tuple[Linked, Engine]:
        linked: Any = Linked(self.problems, self.links)  # type: ignore[arg-type]
        return linked, backend_of(self.solver).build(linked, self.deadline)

    def plan(
        self,
        x: np.ndarray,
        wanted: Sequence[Reference | Mapping[str, Any]],
        previous: PhasedPlan | Sequence[Guess | None] | None = None,
        *,
        later: float | None = None,
        applied: np.ndarray | None = None,
    ) -> PhasedPlan:
        """Plan all phases.

        Parameters
        ----------
        x : array, shape (n_states,)
            State of the first phase now, SI units.
        wanted : sequence of Reference or mapping
            Of each phase, what is wanted; by name as in `MPC.plan`.
        previous : PhasedPlan or sequence of Guess, optional
            A plan of the same phases to start from; or for each phase a guess of your own by `MPC.guess`, None where
            there is none. The first states of a guess count, but in the first phase; what is held goes on from the
            phase before.
        later : float, optional
            Time since the plan before [s], which then is moved on by it, as `slipangle.control.moved.moved` says: the
            first phase whose duration is free has so much less of it left, and the others go on behind it; where none
            is free, all phases move on as the horizon of an `MPC` does. The plan is iterated to convergence from there.
        applied : array, shape (n_controls,), optional
            Inputs of the first phase before; by default those of the plan before, if this one is `later`, else zero.

        Raises
        ------
        ParameterError
            If an argument has another shape, a phase lacks its wanted values, a guess is of another problem, or there
            is no plan before that this one could be later than.
        """
        begin = perf_counter()
        phases: Any = self.problems
        first = phases[0]
        x = vector(x, first.model.states, "the state")
        known = previous if isinstance(previous, PhasedPlan) else None
        old = _before(later, known, phases)
        rest = np.zeros(len(first.controls)) if old is None else old.command
        rest = np.clip(rest, *first.input_bounds.T)
        before = rest if applied is None else applied_input(applied, first.controls)
        _require_wanted(wanted, len(phases))
        references = [
            p.check_reference(r) if isinstance(r, Reference) else setpoint(p, r)
            for p, r in zip(phases, wanted, strict=True)
        ]
        way = [] if old is None else moved(old.phases, phases, references, float(later or 0.0))
        guesses = way or ([None] * len(phases) if previous is None or known else _each(previous, phases))
        begin -= perf_counter()  # what is built once is not the plan's time
        (linked, engine), _ = self._parts, self._finer
        begin += perf_counter()
        u0 = linked.resting(before, references, guesses)
        reference = linked.spread(u0, references)
        state = np.zeros(linked.model.n_states)
        state[: len(x)] = x
        if self.deadline is not None:
            engine.allow(self.deadline - (perf_counter() - begin))
        found = None if known is None or later is not None else engine.resume(state, u0, reference, known.start)
        if found is None:
            u, states = linked.begin(x, u0, reference.exogenous, guesses)
            found = engine.solve(Start(x=state, applied=u0, reference=reference, guess_u=u, guess_x=states))
        plan = _taken_apart(linked, found)
        for said in self._astray(plan, references) if plan.status.solved else ():
            warnings.warn(said, ModelWarning, stacklevel=2)
        if old is not None and not plan.status.solved:
            u = within(way[0].inputs(before, first.horizon), before, first.input_bounds, first.step_bounds)
            plan = _moved_on(old, plan, way, u)
        return replace(plan, seconds=perf_counter() - begin)

    @built
    def _finer(self) -> list[Finer | None]:
        return [None if phase.duration is None else Finer(phase) for phase in self.problems]  # type: ignore[union-attr]

    def _astray(self, plan: PhasedPlan, references: Sequence[Reference]) -> list[str]:
        """Of phases with a free duration, what the integrator's steps miss over it."""
        each = zip(self._finer, plan.phases, references, strict=True)
        said = [f.sentence(p.x, p.u, r.exogenous, p.decided) if f is not None else "" for f, p, r in each]
        return [f"phase {k}: {sentence}" for k, sentence in enumerate(said) if sentence]


def _before(later: Any, known: PhasedPlan | None, phases: Sequence[OCP]) -> PhasedPlan | None:
    """The plan that this one is later than, if that was one.

    Raises
    ------
    ParameterError
        If there is none of these phases, or the time is none.
    """
    if later is None:
        return None
    if not is_number(later) or not 0 <= later < np.inf:
        raise ParameterError(f"later is {short(later)}; expected the time since the plan before, 0 or more [s]")
    own = [] if known is None else [(p.states, p.controls, p.u.shape) for p in known.phases]
    if known is None or own != [(p.model.states, p.controls, (p.horizon, len(p.controls))) for p in phases]:
        raise ParameterError(
            "later is given without a plan of these phases; expected the plan before as previous, or no later"
        )
    return known if known.status.solved or known.age else None


def _moved_on(old: PhasedPlan, failed: PhasedPlan, way: Sequence[Any], u: np.ndarray) -> PhasedPlan:
    """The plan before, where this one was not found; with these inputs of the first phase."""
    phases, now = [], 0.0
    for k, (own, said) in enumerate(zip(old.phases, way, strict=True)):
        times = own.times - own.times[0]
        times = now + times * (said.decided.get("duration", times[-1]) / times[-1])
        now = float(times[-1])
        phases.append(replace(own, u=said.u if k else u, x=said.x, times=times, decided=dict(said.decided)))
    nothing = {"cost": np.nan, "violation": np.inf, "residual": np.inf}
    return replace(failed, phases=tuple(phases), start=old.start, age=old.age + 1, **nothing)


def _same(x: Any) -> Any:
    return x


def _many(given: Any) -> str:
    return f" of {len(given)}" if isinstance(given, Sequence) else ""


def _require_wanted(wanted: Any, count: int) -> None:
    """Raise ParameterError unless it is a list of what is wanted in each phase."""
    single = f"one {type(wanted).__name__}" if isinstance(wanted, Mapping | Reference) else short(wanted)
    if not isinstance(wanted, list | tuple):
        raise ParameterError(f"wanted is {single}; expected a list of {count}, what is wanted in each phase")
    if len(wanted) != count:
        raise ParameterError(f"wanted has {len(wanted)} entries; expected one for each of {count} phases")
    for k, own in enumerate(wanted):
        if not isinstance(own, Mapping | Reference):
            raise ParameterError(
                f"wanted[{k}] is {short(own)}; expected what is wanted in phase {k} by name, such as "
                '{"v_x": 20.0}, or a Reference; {} where nothing is'
            )


def _each(given: Any, phases: Sequence[OCP]) -> list[Guess | None]:
    """A guess or None for each phase.

    Raises
    ------
    ParameterError
        If these are none, or one is of another problem.
    """
    if not isinstance(given, list | tuple) or not all(g is None or isinstance(g, Guess) for g in given):
        raise ParameterError(
            f"previous is {short(given)}; expected a plan of these phases, or a list of {len(phases)} guesses by "
            "MPC.guess, one per phase, None where there is none"
        )
    if len(given) != len(phases):
        raise ParameterError(
            f"previous has {len(given)} guesses; expected one or None for each of {len(phases)} phases"
        )
    for k, (own, phase) in enumerate(zip(given, phases, strict=True)):
        if own is not None:
            own.require(phase, f"phase {k}")
    return list(given)


def _taken_apart(linked: Linked, found: Solution) -> PhasedPlan:
    status = found.status if finite(found.u, found.x) or not found.status.solved else Status.NOT_FINITE
    phases, now = [], 0.0
    for base, part, start, own in zip(linked.bases, linked.parts, linked.starts, linked.slots, strict=True):
        at = int(start) + part.horizon - base.horizon
        rows = slice(at, at + base.horizon)
        n, once = base.model.n_states, base.decided_once
        decided = dict(zip(once, map(float, found.x[at, n : n + len(once)]), strict=True))
        times = base.times * (decided["duration"] / base.times[-1] if "duration" in decided else 1.0)
        phases.append(
            PhasePlan(
                u=np.array(found.u[rows][:, own[: len(base.controls)]]),
                x=np.array(found.x[at : at + base.horizon + 1, :n]),
                times=now + times,
                controls=base.controls,
                states=base.model.states,
                decided=decided,
            )
        )
        now += float(times[-1])
    return PhasedPlan(
        phases=tuple(phases),
        status=status,
        cost=found.cost,
        iterations=found.iterations,
        seconds=0.0,
        violation=found.violation,
        residual=found.residual,
        start=found.as_start(linked.controls),
    )
