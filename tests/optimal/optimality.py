"""How far inputs are from a local optimum, by the gradient of the cost along the rolled-out states."""

import casadi as ca
import numpy as np


def projected_gradient(ocp, x, reference, applied, u):
    """Largest slope of the cost over its value, per half range of an input, that its bounds would let it follow.

    For problems without limits on states or rates.
    """
    free = ca.MX.sym("u", len(ocp.controls), ocp.horizon)
    q, r, s = (ca.DM(w.T) for w in ocp.stage_weights)
    state, before, cost = ca.MX(ca.DM(x)), ca.MX(ca.DM(applied)), 0
    for i in range(ocp.horizon):
        now, w = free[:, i], ca.DM(reference.exogenous[i])
        error = ocp.stage(state, now, w, ca.DM(reference.tracked[i]))[0]
        cost += ca.dot(q[:, i], error**2) + ca.dot(r[:, i], now**2) + ca.dot(s[:, i], (now - before) ** 2)
        for _ in range(ocp.lengths[i]):
            state = ocp.dynamics(state, now, w)
        before = now
    error = ocp.stage(state, before, w, ca.DM(reference.tracked[-1]))[0]
    cost += ca.dot(q[:, -1], error**2)
    value, slope = ca.Function("j", [free], [cost, ca.gradient(cost, ca.vec(free))])(u.T)
    low, high = ocp.input_bounds.T
    slope = np.asarray(slope).reshape(u.shape) * 0.5 * (high - low) / float(value)
    size = 1e-9 * (high - low)
    blocked = ((u <= low + size) & (slope > 0)) | ((u >= high - size) & (slope < 0))
    return float(np.abs(np.where(blocked, 0.0, slope)).max())
