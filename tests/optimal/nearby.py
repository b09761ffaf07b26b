"""Whether a plan is a local optimum, by Ipopt: held to inputs nearby, it finds none that is better."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.optimal.engine import Start
from slipangle.optimal.ipopt import IpoptEngine
from slipangle.optimal.joined_engine import JoinedEngine

# of inputs: free to go further, an interior point method leaves the optimum that it starts from for another; the next
# one where it ends without an answer, as it can by rounding between two bounds and a limit
REACHES = 1e-3, 1e-4
KEPT = 1e-12  # of limits, by a plan whose cost counts


class Held:
    """A solver that is held to inputs nearby those that it starts from."""

    def __init__(self, solver, columns, reach):
        self.solver, self.columns, self.reach, self.stats = solver, columns, reach, solver.stats

    def __call__(self, *, x0, lbx, ubx, **others):
        lbx[self.columns] = np.maximum(lbx[self.columns], x0[self.columns] - self.reach)
        ubx[self.columns] = np.minimum(ubx[self.columns], x0[self.columns] + self.reach)
        return self.solver(x0=x0, lbx=lbx, ubx=ubx, **others)


def is_local_optimum(engine, start, plan, close):
    """Whether Ipopt, held nearby, ends at the inputs of the plan that it starts from; where joined, at all of them.

    Or at more cost: about the kink of a Huber cost it ends as far off as the root of its barrier.
    """
    kept = plan.violation < KEPT
    if isinstance(engine, JoinedEngine):
        joined, engine, plan = engine.joined, engine.inner, plan.start
        start = Start(
            x=joined.state(start.x),
            applied=joined.resting(start.applied),
            reference=joined.spread(start.x, start.applied, start.reference),
            guess_u=start.guess_u,
            guess_x=start.guess_x,
        )
    assert isinstance(engine, IpoptEngine)
    usual = engine._cold
    for reach in REACHES:
        engine._cold = Held(usual, engine._layout.u, reach)
        try:
            found = engine.solve(replace(start, guess_u=plan.u, guess_x=plan.x, memory=None))
        finally:
            engine._cold = usual
        if found.status.solved:
            break
    better = kept and plan.cost < found.cost
    return found.status.solved and (better or found.u == pytest.approx(plan.u, abs=close))
