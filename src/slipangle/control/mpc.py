"""`MPC`: an optimal control problem solved again at every step, and what to do when that fails."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isnan
from time import perf_counter
from typing import Any

import numpy as np

from slipangle.control.batch import plan_many
from slipangle.control.call import both, doubt, given
from slipangle.control.controller import Ahead
from slipangle.control.fallback import Call, Fallbacks
from slipangle.errors import ModelWarning, ParameterError
from slipangle.numerics.per_thread import built
from slipangle.optimal.checks import health_of, is_numbers, require_plan, stuck
from slipangle.optimal.engine import Start
from slipangle.optimal.guess import Guess, guess
from slipangle.optimal.ocp import Reference
from slipangle.optimal.setpoints import setpoint, vary
from slipangle.optimal.solution import (
    ANEW,
    FEASIBLE,
    Health,
    Plan,
    Solution,
    Status,
    finite,
    inputs_later,
    quick,
    states_later,
    within,
)
from slipangle.optimal.stretched import Finer
from slipangle.paths.preview import Preview


@dataclass(frozen=True, eq=False, init=False)
class MPC(Fallbacks):
    """Model predictive controller: an `OCP` with a solver, a deadline and a fallback.

    When a solve fails, runs out of time, or the state is no number or far outside what it can be, the plan is the
    previous one shifted by a step, at most `fallback` times in a row; after that, or with no previous plan, the safe
    stop law: every input relaxes to its `safe` value with a time constant of half a second, so that 37 % of the way are
    left after that and 5 % after 1.5 s. Whatever its source, a command is finite and within limits and rates, and a
    failed solve leaves no trace in the next one's start: one that led nowhere from the plan before begins anew, as
    `Plan.detail` then says. `Plan.health` counts what went wrong.

    Parameters
    ----------
    model : Model, optional
        Predicts; with it come the settings of an `OCP`, by their names: ``MPC(model, horizon=20, Q=..., limits=...)``.
    ocp : OCP, optional
        The problem, where it is posed already; settings beside it replace its own.
    solver : {"realtime", "ipopt"} or Backend
        The solver, or its settings, such as ``RealTime(iterations=2)`` or ``Ipopt(tolerance=1e-6)``. The real-time one
        runs compiled, or slower where no compiler is, with the same answer; Ipopt is the reference to compare with.
    deadline : float, optional
        Longest wall time of one call of `plan`; the solver ends early enough for a fallback. [s]
    fallback : int
        How many steps in a row a shifted plan may serve; never more than the plan has left.
    safe : Values
        Inputs of the safe stop law, such as brake torque; by default zero, or the limit nearest to it.
    plausible : Limits
        Ranges of states, references and exogenous inputs beyond which a value is taken for a fault; by default twice
        the largest size of the standard channel of that name, 1e7 m for positions, 1e12 for names of your own.
    """

    def prepare(self, reference: Reference | Preview | None = None, previous: Plan | Guess | None = None) -> None:
        """Do now what the next `plan` can do without.

        Parameters
        ----------
        reference, previous : optional
            Of the next `plan`. A real-time solver then linearises around the plan before the state is known, so
            the next call of `plan` with the same two answers sooner; other solvers are only built, so that no
            plan counts that time as its own.
        """
        engine, _ = self._engine, self._finer
        if reference is not None and previous is not None and not isinstance(previous, Guess):
            wanted = self.reference(reference) if isinstance(reference, Preview) else reference
            wanted = self.check_reference(wanted)
            require_plan(previous)
            known = self._known(previous)
            if known is not None and is_numbers(known.x, self._shape_x) and _others_finite(wanted):
                expected = known.x[1]
                if self._judge.status(expected, wanted.tracked, wanted.exogenous) is None:
                    engine.prepare(self._before(known, None), self._unwound(wanted, expected), known)

    def setpoint(self, **wanted: float | np.ndarray | Mapping[str, Any]) -> Reference:
        """`Reference` without a path, by name.

        Parameters
        ----------
        **wanted : float or array, shape (horizon + 1,)
            Values of tracked quantities, of exogenous inputs and of decided inputs, as in `plan`; limits and weights as
            in `vary`. SI units.

        Raises
        ------
        ParameterError
            If a name is not known or missing, or values are no numbers of shape (horizon + 1,).
        """
        return setpoint(self.ocp, wanted)

    def vary(self, reference: Reference, **of: Mapping[str, Any]) -> Reference:
        """The same reference with limits and weights that change over the horizon; nothing is compiled again.

        Parameters
        ----------
        reference : Reference
            What is wanted.
        **of : mapping
            ``limits`` of names to pairs, ``Q``, ``R`` and ``S`` of names to weights, each a number or one per node, and
            ``scenarios`` of names to values, as in `slipangle.optimal.setpoints.vary`. SI units.
        """
        return vary(self.ocp, reference, **of)

    def guess(
        self,
        *,
        x: np.ndarray | Mapping[str, Any] | None = None,
        u: np.ndarray | Mapping[str, Any] | None = None,
        decided: Mapping[str, float] | None = None,
    ) -> Guess:
        """An initial guess of your own for `plan`, as its ``previous``: it begins there, without a shift.

        Parameters
        ----------
        x : array, shape (horizon + 1, n_states) or (2, n_states), or mapping, optional
            States at `times`, or the first and the last with a straight line between them; or by name a number that
            holds, horizon + 1 of them or a first and a last one, where states without a name stay as they are now. The
            first row is replaced by the state now. By default the states that the inputs lead to. SI units.
        u : array, shape (horizon, n_controls), or mapping, optional
            Decided inputs; or by name a number that holds, or one per stage. What is not said is held as it was applied
            before. They are brought within limits and rates when the plan begins. SI units.
        decided : mapping of str to float, optional
            Of what is decided once, as `Plan.decided` has it: free parameters, and the ``duration`` where it is free.
            SI units.

        Raises
        ------
        ParameterError
            If nothing is given, a name is not known, values are no finite numbers of these shapes, or one of
            ``decided`` is beyond its limits.
        """
        return guess(self.ocp, x=x, u=u, decided=decided)

    def plan(
        self,
        x: np.ndarray,
        /,
        reference: Ahead | None = None,
        previous: Plan | Guess | None = None,
        *,
        applied: np.ndarray | None = None,
        **values: float | np.ndarray | Mapping[str, Any],
    ) -> Plan:
        """See `Controller.plan`; without a reference, what is wanted is said by name, such as ``r=0.3``.

        Parameters
        ----------
        x, reference, previous, applied
            As there; instead of a plan before, a `guess`, after which nothing counts as planned before. An input
            applied that is no number is unknown: the plan before's counts, else zero, and `Plan.detail` says so.
        **values : float or array, shape (horizon + 1,)
            Of tracked quantities, of exogenous inputs, which must all be there, and of decided inputs, from
            which R counts. Tracked quantities that are not named are wanted at zero, but a pose or a speed must be
            said. ``limits``, ``Q``, ``R``, ``S`` and ``scenarios`` are those of `vary`. SI units.
        """
        _ = self._engine, self._finer
        begin = perf_counter()
        if reference is None or values:
            reference = self._said(reference, values)
        if type(previous) is Plan and type(reference) is Reference:
            planned = self._again(x, reference, previous, applied, begin)
            if planned is None:
                planned = self._lost(x, reference, previous, applied, begin)
            if planned is not None:
                return planned
        own = previous if isinstance(previous, Guess) else None
        if own is not None:
            own.require(self.ocp)
        previous = None if isinstance(previous, Guess) else previous
        x, wanted = given(self, x, reference, previous)
        before = self._before(previous, applied)
        wrong = self._judge.status(x, wanted.tracked, wanted.exogenous)
        if wrong is None and not _others_finite(wanted):
            wrong = Status.NOT_FINITE
        call = Call(
            x, wanted, previous, before, begin, wrong is None, doubt(applied, self.controls, *self._input_range)
        )
        if wrong is not None:
            detail = self._judge.fault(x, wanted.tracked, wanted.exogenous) if wrong is Status.IMPLAUSIBLE else ""
            return self._fallback(call, wrong, detail=detail)
        if self.deadline is not None:
            self._engine.allow(self._left(begin) - self._pace[0])
        try:
            known = self._known(previous) if own is None else own
            solution = self._solve(x, self._unwound(wanted, x), known, before)
        except Exception as error:  # a solver from outside may stop with any
            return self._fallback(call, Status.FAILED, detail=str(error).partition("\n")[0] or type(error).__name__)
        return self._ended(call, solution)

    def plan_many(
        self,
        x: np.ndarray,
        /,
        reference: Ahead | Sequence[Ahead] | None = None,
        previous: Sequence[Plan | Guess | None] | None = None,
        *,
        applied: np.ndarray | None = None,
        threads: int | None = None,
        **values: float | np.ndarray | Mapping[str, Any] | Sequence[Any],
    ) -> list[Plan]:
        """Plan from many states side by side; every plan is the one that `plan` gives for it alone, to the last bit.

        Parameters
        ----------
        x : array, shape (n, n_states)
            States.
        reference : Reference or Preview, or a sequence of them, optional
            What to do from each state, or from all; without one it is said by name.
        previous : sequence of Plan or None, optional
            Of each state, the plan of the step before, or a `guess`.
        applied : array, shape (n, n_controls), optional
            Inputs applied over the step before.
        threads : int, optional
            Threads that share the work, each with a work area of its own; by default one per core.
        **values : float, or array of shape (n,), (n, horizon + 1) or (1, horizon + 1)
            As in `plan`: a number for all, one for each state, a row over the horizon for each, or one row for all.
            ``limits``, ``Q``, ``R``, ``S`` and ``scenarios`` are a mapping for all, or a list of one for each.

        Raises
        ------
        ParameterError
            If there is not one of each for every state, or an argument is not as `plan` wants it.
        """
        return plan_many(self, x, reference, previous, applied, threads, values, self._said)

    # ---- the parts ---------------------------------------------------------------------------------------------

    def _said(self, reference: Ahead | None, wanted: dict[str, Any]) -> Reference:
        """The reference of what is said by name.

        Raises
        ------
        ParameterError
            If there is a reference too, or neither.
        """
        if reference is not None:
            raise ParameterError(
                f"plan() has a reference and {list(wanted)}; expected one of both: say mpc.setpoint(...) for the first"
            )
        return setpoint(self.ocp, wanted)

    def _again(
        self, x: np.ndarray, reference: Reference, previous: Plan, applied: np.ndarray | None, begin: float
    ) -> Plan | None:
        """The usual call, from the plan that the engine still holds, in as few steps as possible; None for others."""
        health = previous.health
        if type(health) is not Health:
            return None
        left = None if self.deadline is None else self._left(begin) - self._pace[0]
        answer = self._engine.again(x, reference, previous, applied, left)
        if answer is None:
            return None
        status = answer["status"]
        if not (status is Status.REAL_TIME or status.solved):  # the usual one without a call
            call = Call(x=x, wanted=reference, previous=previous, before=self._before(previous, applied), begin=begin)
            return self._ended(call, Solution(**answer, kept=True))
        answer["controls"], answer["times"] = self.controls, self.times
        answer["seconds"] = seconds = perf_counter() - begin
        late = self.deadline is not None and seconds > self.deadline
        answer["health"] = health.after(False, late, answer.get("detail", "").startswith(ANEW))
        return quick(Plan, answer)

    def _ended(self, call: Call, solution: Solution) -> Plan:
        """The plan of a solution, or a fallback where it is none."""
        previous, before, status = call.previous, call.before, solution.status
        begun = status.unfinished and solution.iterations > 0 and solution.violation <= FEASIBLE
        if not (status.solved or begun):
            left = solution.memory if status.resumes else None
            return self._fallback(call, status, solution.iterations, solution.detail, left)
        if not finite(solution.u, solution.x):
            wrong = Status.NOT_FINITE if status.solved else status
            return self._fallback(call, wrong, solution.iterations, solution.detail)
        duration = (solution.decided or {}).get("duration")
        said = self._astray(solution, call.wanted)
        seconds = perf_counter() - call.begin
        values = {
            "u": solution.u
            if solution.kept
            else within(solution.u, before, self.ocp.input_bounds, self.ocp.step_bounds_over(duration)),
            "x": solution.x,
            "status": status,
            "cost": solution.cost,
            "iterations": solution.iterations,
            "controls": self.controls,
            "residual": solution.residual,
            "violation": solution.violation,
            "memory": solution.memory,
            "detail": both(both(solution.detail, call.doubt), said),
            "times": self.times,
            "health": health_of(previous).after(
                False, self.deadline is not None and seconds > self.deadline, solution.detail.startswith(ANEW)
            ),
            "seconds": seconds,
        }
        if solution.branches or solution.decided is not None:
            values |= {"branches": solution.branches, "decided": solution.decided}
        if duration is not None:
            values["times"] = self.times * (duration / self.times[-1])
        return quick(Plan, values)

    @built
    def _finer(self) -> Finer | None:
        return Finer(self.ocp) if self.ocp.duration is not None else None

    def _astray(self, solution: Solution, wanted: Reference) -> str:
        """What the integrator's steps miss over the duration decided; a warning, too."""
        if self._finer is None or solution.decided is None:
            return ""
        said = self._finer.sentence_of(solution, wanted)
        if said:
            warnings.warn(said, ModelWarning, stacklevel=4)
        return said

    def _unwound(self, wanted: Reference, x: np.ndarray) -> Reference:
        """The reference with its heading on the turn nearest to the vehicle's."""
        if self.ocp.headings is None:
            return wanted
        here, column = self.ocp.headings
        turns = np.round((x[here] - wanted.tracked[0, column]) / (2 * np.pi))
        if turns == 0:
            return wanted
        tracked = np.array(wanted.tracked, dtype=float)
        tracked[:, column] += 2 * np.pi * turns
        return replace(wanted, tracked=tracked)

    def _begun(self, x: np.ndarray, wanted: Reference, guess: Guess, before: np.ndarray) -> Start:
        """What a guess of somebody's own begins with."""
        u = within(guess.inputs(before, self.horizon), before, self.ocp.input_bounds, self.ocp.step_bounds)
        states = guess.states_from(x)
        if states is None:
            states = self._engine.roll_out(x, u, wanted, guess.decided)
        if states is None:
            states = self._roll_out(x, u, wanted)
        if not np.isfinite(states).all():
            states = np.tile(x, (self.horizon + 1, 1))
        return Start(x=x, applied=before, reference=wanted, guess_u=u, guess_x=states, decided=guess.decided)

    def _solve(self, x: np.ndarray, wanted: Reference, previous: Plan | Guess | None, before: np.ndarray) -> Solution:
        engine, memory, decided = self._engine, None, None
        if isinstance(previous, Guess):
            return engine.solve(self._begun(x, wanted, previous, before))
        resumed = engine.resume(x, before, wanted, previous)
        if resumed is not None:
            return resumed
        if previous is None or stuck(previous):
            u = np.tile(before, (self.horizon, 1))
            states = self._roll_out(x, u, wanted)
        else:
            u = within(inputs_later(previous.u, self.ocp.lengths), before, self.ocp.input_bounds, self.ocp.step_bounds)
            known = is_numbers(previous.x, self._shape_x)
            if self.horizon > 1 and known:
                states = states_later(previous.x, self.ocp.nodes)
                states[0] = x
                states[-1] = np.asarray(
                    self.ocp.dynamics(previous.x[-1], u[-1], wanted.exogenous[self.horizon - 1])
                ).ravel()
            else:
                states = self._roll_out(x, u, wanted)
            memory, decided = previous.memory, previous.decided
        if not np.isfinite(states).all():
            states, memory = np.tile(x, (self.horizon + 1, 1)), None
        return engine.solve(
            Start(x=x, applied=before, reference=wanted, guess_u=u, guess_x=states, memory=memory, decided=decided)
        )


def _others_finite(reference: Reference) -> bool:
    """Whether wanted inputs are numbers and the corridor nowhere NaN."""
    inputs, corridor = reference.inputs, reference.corridor
    return (inputs is None or finite(inputs)) and (corridor is None or not isnan(np.vdot(corridor, corridor)))
