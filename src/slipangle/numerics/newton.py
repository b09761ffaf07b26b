"""Solutions of small systems of equations as expressions: a fixed number of Newton steps, derivatives by theorem.

Whatever a model needs inside its rates - rates that are given by equations, loads that depend on the acceleration that
they cause - becomes an ordinary function of state and inputs, which every integrator, fit and solver can use.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

FAR = 1e-6  # a last Newton step beyond this, relative to 1 + |y|, has found no solution


def solution(residual: ca.Function, guess: ca.Function, steps: int) -> ca.Function:
    """``(*given) -> y`` with ``residual(y, *given) = 0``, by so many Newton steps from ``guess(*given)``.

    Where the residual is a straight line in y, one elimination is all. Else the steps are one call, which is not
    differentiated; two steps with the inverse Jacobian from there carry the derivatives by the implicit function
    theorem, first and second ones to rounding. y is NaN where Newton's method does not get there.
    """
    y, *given = residual.sx_in()
    r = residual(y, *given)
    slope = ca.jacobian(r, y)
    names = residual.name_in()[1:]
    if not ca.depends_on(slope, y):
        at_zero = residual(ca.DM.zeros(y.shape), *given)
        return ca.Function("solution", given, [-_divided(slope, at_zero)], names, ["y"])
    move = ca.Function("move", [y, *given], [_divided(slope, r)])
    found, last = guess(*given), ca.SX(0)
    for _ in range(steps):
        last = move(found, *given)
        found = found - last
    off = ca.sumsqr(last / (1 + ca.fabs(found)))
    found = ca.if_else(off <= FAR**2, found, ca.DM.nan(y.shape))
    inverse = ca.Function("inverse", [y, *given], [ca.densify(_divided(slope, ca.DM.eye(y.numel())))])
    options = {"never_inline": True, "is_diff_in": [False] * len(given)}
    call = ca.Function("newton", given, [ca.densify(found), inverse(found, *given)], names, ["y", "inverse"], options)
    now, by = call(*given)
    for _ in range(2):
        now = now - ca.mtimes(by, residual(now, *given))
    return ca.Function("solution", given, [now], names, ["y"])


def _divided(matrix: Any, right: Any) -> Any:
    """Solution of a linear system: by minors where there are one or two unknowns, else by an orthogonal matrix."""
    small = matrix.shape[0] <= 2
    return ca.mtimes(ca.inv_minor(ca.densify(matrix)), right) if small else ca.solve(matrix, right)
