"""`JoinedEngine`: a problem of several parts solved as the one that it is, and its answer taken apart."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from slipangle.optimal.engine import Engine, Start
from slipangle.optimal.joined import Joined, rated
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import Branch, Plan, Solution


class JoinedEngine(Engine):
    """Solves a problem with scenarios, free parameters or Huber costs as one, and takes the answer apart."""

    def __init__(self, joined: Joined, inner: Engine) -> None:
        self.joined, self.inner = joined, inner

    def solve(self, start: Start) -> Solution:
        """Solve from a state and a guess, the same for all scenarios."""
        problem = self.joined
        base, n = problem.base, problem.base.horizon
        reference = problem.spread(start.x, start.applied, start.reference)
        once = problem.guess(start.reference, start.decided)
        rest = problem.resting(start.applied)
        rest[len(base.controls) : len(base.controls) + len(once)] = once
        u, x = np.tile(rest, (problem.horizon, 1)), np.zeros((problem.horizon + 1, problem.model.n_states))
        x[0] = problem.state(start.x)
        for at in problem.starts:
            u[at : at + n, : len(base.controls)] = start.guess_u
            x[at : at + n + 1, : base.model.n_states] = start.guess_x
        kept = np.concatenate([once, start.guess_u[: problem.common].ravel()])
        here = base.model.n_states + len(kept)
        x[1:, base.model.n_states : here] = kept
        for at in problem.starts:
            x[at + 1 : at + n + 1, here:] = start.guess_u[:, [base.controls.index(name) for name in rated(base)]]
        inner = Start(
            x=x[0],
            applied=problem.resting(start.applied),
            reference=reference,
            guess_u=u,
            guess_x=x,
        )
        return self._apart(self.inner.solve(inner))

    def resume(
        self, x: np.ndarray, applied: np.ndarray, reference: Reference, previous: Plan | None
    ) -> Solution | None:
        """Solve from a state and the plan of the step before; without one, from nothing, if the solver does so."""
        problem = self.joined
        known = previous.start if previous is not None else None
        if not (isinstance(known, Plan) and known.u.shape == (problem.horizon, len(problem.controls))):
            return None
        found = self.inner.resume(
            problem.state(x), problem.resting(applied), problem.spread(x, applied, reference), known
        )
        return None if found is None else self._apart(found)

    def roll_out(
        self, x: np.ndarray, u: np.ndarray, reference: Reference, decided: Mapping[str, float]
    ) -> np.ndarray | None:
        """States that inputs lead to with what is decided once, in the most probable scenario; see `Engine`."""
        problem, n, nx = self.joined, len(u), len(x)
        at, kept = int(problem.starts[np.argmax(problem.share)]), problem.state(x)
        once = problem.guess(reference, decided)
        kept[nx : nx + len(once)] = once
        w = problem.spread(x, u[0], reference).exogenous
        inputs = np.tile(problem.resting(u[0]), (n, 1))
        inputs[:, : u.shape[1]] = u
        states = np.tile(kept, (n + 1, 1))
        for i in range(n):
            states[i + 1, :nx] = np.asarray(problem.dynamics(states[i], inputs[i], w[at + i])).ravel()[:nx]
        return states[:, :nx]

    def allow(self, seconds: float) -> None:
        """See `Engine`."""
        self.inner.allow(seconds)

    def _apart(self, found: Solution) -> Solution:
        """The answer of the base problem, with a branch for each scenario."""
        problem = self.joined
        base, n, nu, nx = problem.base, problem.base.horizon, len(problem.base.controls), problem.base.model.n_states
        u = [np.array(found.u[at : at + n, :nu]) for at in problem.starts]
        x = [np.array(found.x[at : at + n + 1, :nx]) for at in problem.starts]
        likely, decided = int(np.argmax(problem.share)), found.x[problem.starts[0], nx : nx + len(base.decided_once)]
        return Solution(
            u=u[likely],
            x=x[likely],
            status=found.status,
            cost=found.cost,
            iterations=found.iterations,
            violation=found.violation,
            residual=found.residual,
            memory=found.as_start(problem.controls),
            kept=found.kept,
            detail=found.detail,
            branches=() if base.scenarios is None else tuple(map(Branch, u, x, problem.share.tolist())),
            decided=dict(zip(base.decided_once, map(float, decided), strict=True)) if base.decided_once else None,
        )
