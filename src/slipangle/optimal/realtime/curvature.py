"""Second derivatives of a Lagrangian, node by node: what an exact Hessian adds to squares of errors."""

from __future__ import annotations

from typing import Any

import casadi as ca

from slipangle.codegen.compiler import compiler
from slipangle.codegen.expression import scalars
from slipangle.errors import ParameterError
from slipangle.models.ode import OdeModel
from slipangle.optimal.linked import Linked
from slipangle.optimal.ocp import OCP


def curvature_function(ocp: OCP) -> ca.Function:
    """``(x, u, w, p, pi, mu, nu) -> M``: Hessian by x and u of ``pi next + mu limited + nu error``, in half the cost.

    Raises
    ------
    ParameterError
        If dynamics or stage have no scalar code.
    """
    dynamics, stage = scalars(ocp.dynamics), scalars(ocp.stage)
    if dynamics is None or stage is None:
        raise ParameterError(
            "the exact Hessian needs equations of elementary functions, which this model has not; expected such a "
            "model, or RealTime() with Gauss-Newton steps"
        )
    x, u, w, _, p = ocp.symbols(ca.SX)
    pi, mu, nu = (ca.SX.sym(n, k) for n, k in (("pi", x.shape[0]), ("mu", len(ocp.limited)), ("nu", len(ocp.tracked))))
    error, limited = stage(x, u, w, p)
    total: Any = ca.dot(pi, dynamics(x, u, w)) + ca.dot(nu, error)
    total = total + ca.dot(mu, limited) if ocp.limited else total
    hessian = ca.densify(ca.hessian(total, ca.vertcat(x, u))[0])
    return ca.Function("curvature", [x, u, w, p, pi, mu, nu], [hessian])


def require_curvature(ocp: OCP) -> None:
    """Raise unless a problem has an exact Hessian here.

    Raises
    ------
    ParameterError
        With what stands in its way.
    """
    model = ocp.model
    wrong = {
        "there is no C compiler": not compiler(),
        "the problem has several phases": isinstance(ocp, Linked),
        "its stages are several steps long": ocp.steps is not None,
        "the model steps by an implicit integrator": isinstance(model, OdeModel) and model.method == "radau",
    }
    for what, found in wrong.items():
        if found:
            raise ParameterError(f"{what}, which the exact Hessian does not go with; expected Gauss-Newton: RealTime()")
