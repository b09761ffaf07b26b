"""Scenarios and free parameters as one plain nonlinear program, every branch written out: for tests."""

import casadi as ca
import numpy as np


def solve(problem, x, tolerance=1e-12):
    """Cost, inputs of each branch, shape (n_branches, horizon, n_inputs), states, and what was decided once.

    Parameters
    ----------
    problem : dict
        ``step(x, u, value, once)``, ``value`` that of the branch; ``stage(x, u, value, once)`` and ``end(x, once)``
        costs; ``values`` and ``shares`` of the branches; ``horizon``, ``common``, ``bounds`` of inputs, ``applied``,
        ``change`` (weights of input changes), ``rate`` (limit of these), ``state`` (bounds of states), ``soft``
        (index of a state, limit, squared and plain weight), ``once`` (bounds of what is decided once), ``final`` (state
        at the end).
    x : array, shape (n_states,)
        State now.
    tolerance : float
        Of Ipopt.
    """
    n, shares = problem["horizon"], problem["shares"]
    nu, nx = len(problem["bounds"]), len(x)
    opti = ca.Opti()
    limits = problem.get("once", [])
    once = opti.variable(len(limits)) if limits else ca.MX(0, 1)
    for i, (low, high) in enumerate(limits):
        opti.subject_to(opti.bounded(low, once[i], high))
        opti.set_initial(once[i], 0.5 * (low + high))
    cost, first, U, X = 0, None, [], []
    for value, share in zip(problem["values"], shares, strict=True):
        u, states = opti.variable(nu, n), opti.variable(nx, n + 1)
        U.append(u)
        X.append(states)
        opti.set_initial(states, np.tile(np.asarray(x)[:, None], (1, n + 1)))
        opti.subject_to(states[:, 0] == ca.DM(x))
        before = ca.DM(problem["applied"])
        for i in range(n):
            opti.subject_to(states[:, i + 1] == problem["step"](states[:, i], u[:, i], value, once))
            cost += share * problem["stage"](states[:, i], u[:, i], value, once)
            cost += share * ca.dot(ca.DM(problem["change"]), (u[:, i] - before) ** 2)
            for j, (low, high) in enumerate(problem["bounds"]):
                opti.subject_to(opti.bounded(low, u[j, i], high))
            if "rate" in problem:
                opti.subject_to(opti.bounded(-problem["rate"], u[:, i] - before, problem["rate"]))
            before = u[:, i]
            for j, (low, high) in problem.get("state", {}).items():
                opti.subject_to(opti.bounded(low, states[j, i + 1], high))
            if "soft" in problem:
                j, limit, square, plain = problem["soft"]
                over = opti.variable()
                opti.subject_to(over >= 0)
                opti.subject_to(opti.bounded(-limit - over, states[j, i + 1], limit + over))
                cost += share * (square * over**2 + plain * over)
        cost += share * problem["end"](states[:, n], once)
        if "final" in problem:
            opti.subject_to(states[:, n] == ca.DM(problem["final"]))
        for i in range(problem["common"] if first is not None else 0):
            opti.subject_to(u[:, i] == first[:, i])
        first = u if first is None else first
    opti.minimize(cost)
    quiet = {"print_level": 0, "sb": "yes", "tol": tolerance, "bound_relax_factor": 0.0, "max_iter": 500}
    opti.solver("ipopt", {"print_time": False}, quiet)
    found = opti.solve()
    inputs = [np.asarray(found.value(u)).reshape(nu, n).T for u in U]
    return (
        float(found.value(cost)),
        np.array(inputs),
        np.array([np.asarray(found.value(s)).reshape(nx, n + 1).T for s in X]),
        np.ravel(found.value(once)) if limits else np.zeros(0),
    )
