"""Whether the integrator of a model still follows it where a free duration has stretched its steps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from slipangle.optimal.extended import Extension, extended
from slipangle.optimal.joined import own_parameters
from slipangle.optimal.ocp import OCP, Reference
from slipangle.optimal.solution import Solution

FINER, MOST = 4, 0.01  # times as many steps tell the error; share of a state's range that it may have over a horizon


class Finer:
    """The steps of a problem whose duration is decided, by an integrator of `FINER` times as many.

    Parameters
    ----------
    ocp : OCP
        With a free duration.
    """

    def __init__(self, ocp: OCP) -> None:
        self._ocp: Any = ocp
        model: Any = ocp.model
        self._steps = model.substeps
        self._once = own_parameters(ocp, ocp.free)
        self._varied = () if ocp.scenarios is None else own_parameters(ocp, ocp.scenarios.values)
        constant, span = (*self._once, "duration"), ocp.horizon * ocp.dt
        kept = Extension(varied=self._varied, constant=constant, free=self._once, span=span)
        fine = model.resampled(model.dt, substeps=FINER * model.substeps)
        self._both = [extended(m, kept).functions[0].map(ocp.horizon) for m in (model, fine)]

    def sentence_of(self, solution: Solution, wanted: Reference) -> str:
        """`sentence` of a solution, or of the first scenario that has one."""
        given, decided = self._ocp.scenarios, solution.decided or {}
        if given is None or not solution.branches:
            return self.sentence(solution.x, solution.u, wanted.exogenous, decided)
        values = np.transpose([*given.values.values()])[:, None] if wanted.scenarios is None else wanted.scenarios
        for k, (branch, own) in enumerate(zip(solution.branches, values, strict=True)):
            varied = dict(zip(given.values, np.transpose(own), strict=True))
            said = self.sentence(branch.x, branch.u, wanted.exogenous, decided, varied)
            if said:
                return f"scenario {k}: {said}"
        return ""

    def sentence(
        self,
        x: np.ndarray,
        u: np.ndarray,
        exogenous: np.ndarray,
        decided: Mapping[str, float],
        varied: Mapping[str, np.ndarray] | None = None,
    ) -> str:
        """What the plan's steps miss of the equations, over all stages; empty below a hundredth of a state's range.

        Parameters
        ----------
        x, u : array, shapes (horizon + 1, n_states), (horizon, n_controls)
            Of the plan, SI units.
        exogenous : array, shape (horizon or more, n_exogenous)
            Other inputs.
        decided : mapping of str to float
            What is decided once, the duration [s] too.
        varied : mapping of str to array, shape (1,) or (horizon or more,), optional
            What a scenario says of other inputs and parameters.
        """
        ocp = self._ocp
        n, longer = ocp.horizon, decided["duration"] / (ocp.horizon * ocp.dt)
        if not longer > 1 + 1e-9:
            return ""
        given = {**dict(zip(ocp.controls, u.T, strict=True)), **dict(zip(ocp.exogenous, exogenous[:n].T, strict=True))}
        given |= {name: np.broadcast_to(v if len(v) == 1 else v[:n], (n,)) for name, v in (varied or {}).items()}
        inputs = np.array([given[name] for name in (*ocp.model.inputs, *self._varied)])
        fixed = np.tile([[decided[name]] for name in (*self._once, "duration")], n)
        taken, fine = (np.asarray(step(np.vstack([x[:n].T, fixed]), inputs).full()) for step in self._both)
        missed = np.abs(fine - taken)[: x.shape[1]].sum(axis=1)
        size = np.maximum(np.ptp(x, axis=0), 1e-6 * np.maximum(1.0, np.abs(x).max(axis=0)))
        share = np.nan_to_num(missed / size, nan=np.inf)
        worst = int(np.argmax(share))
        if share[worst] <= MOST:
            return ""
        length, steps = decided["duration"] / n, self._steps
        times = "one step" if steps == 1 else f"{steps} steps"
        return (
            f"the duration makes stages of {length:.3g} s, each {times} of the integrator, which miss the equations by "
            f"{missed[worst]:.3g} of '{ocp.model.states[worst]}' ({100 * share[worst]:.2g} % of its range); expected "
            f"at most 1 %: give the model substeps={math.ceil(longer) * steps} or so, or a longer horizon"
        )
