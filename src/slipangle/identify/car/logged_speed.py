"""A car fitted with its speed smoothed, and how it follows that speed as it is logged, with its noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import optimize

from slipangle.data.dataset import Dataset
from slipangle.identify.car.corrections import LOADS
from slipangle.identify.car.structures import Fitted, Others, errors

_SAME = 0.05  # of a lag, to which it is sought


def following(final: Fitted, others: Others, logged: Dataset) -> tuple[Fitted, Others]:
    """A fit with the loads' lag that predicts best from the speed as it is logged, and structures as good, with it.

    That lag is no shorter than the one that was found: noise of the speed is shifted between the axles, and takes their
    grip, unless they follow slowly. All else is as it was found, and all is where the speed was fitted to as logged.
    """
    lag = LOADS[1]
    if lag not in final.free or np.array_equal(logged["v_x"], final.problem.data["v_x"]):
        return final, others
    at, found = final.names.index(lag), final.values[lag]

    def lagging(log: float) -> Fitted:
        z = final.z.copy()
        z[at] = np.exp(log) / final.problem.scale[at]
        return replace(final, model=final.model.with_values(**{lag: float(np.exp(log))}), z=z)

    def cost(log: float) -> float:
        return float(np.log(errors(lagging(log), logged).mean(axis=0)).sum())

    first, last = np.log(found), np.log(final.model.si(lag).upper)
    best = optimize.minimize_scalar(cost, bounds=(first, last), method="bounded", options={"xatol": _SAME})
    return (lagging(float(best.x)), [*others, (final, 1.0)]) if best.fun < cost(first) else (final, others)
