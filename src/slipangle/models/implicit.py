"""Equations that rates are solved from: implicit ones, and algebraic variables beside the states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np

from slipangle.errors import ParameterError
from slipangle.numerics.newton import solution
from slipangle.ops import Scalar, Vector, is_symbolic, is_traced, stack

Guess = float | Callable[[Vector, Vector, Any], Scalar]


class Unknowns:
    """What the equations of an `Ode` are solved for at a state and an input: its rates, its algebraic variables.

    Raises ParameterError if the equations are not as many as the unknowns, or leave one open.

    Parameters
    ----------
    implicit, algebraic : callable or None
        Residuals, see `Ode`.
    n_states, n_inputs : int
        Lengths of x and u.
    guess : mapping
        Names of the algebraic variables, and where Newton's method begins.
    params : ParameterSet
        Parameters; their values do not matter.
    newton : int
        Newton steps.
    """

    def __init__(
        self,
        implicit: Callable[..., Any] | None,
        algebraic: Callable[..., Any] | None,
        *,
        n_states: int,
        n_inputs: int,
        guess: Mapping[str, Guess],
        params: Any,
        newton: int,
    ) -> None:
        self._names = tuple(params.metadata())
        self._n_rates = n_states if implicit is not None else 0
        x, u, p = (ca.SX.sym(n, k) for n, k in (("x", n_states), ("u", n_inputs), ("p", len(self._names))))
        y = ca.SX.sym("y", self._n_rates + len(guess))
        given = params.with_values(**{n: p[i] for i, n in enumerate(self._names)})
        z = [y[self._n_rates :]] if guess else []
        parts = []
        if implicit is not None:
            parts.append(_column(implicit(y[: self._n_rates], x, *z, u, given), n_states, "implicit", "state"))
        if algebraic is not None:
            parts.append(_column(algebraic(x, *z, u, given), len(guess), "algebraic", "name in guess"))
        first = [0.0] * self._n_rates + [g(x, u, given) if callable(g) else float(g) for g in guess.values()]
        residual = ca.densify(ca.vertcat(*parts))
        if ca.sprank(ca.jacobian(residual, y)) < y.numel():
            raise ParameterError(
                "the equations leave a rate or an algebraic variable open, whatever the values; expected some that "
                "give every one: differentiate constraints by time until they do (index reduction)"
            )
        self._solved = solution(
            ca.Function("residual", [y, x, u, p], [residual], ["y", "x", "u", "p"], ["residual"]),
            ca.Function("guess", [x, u, p], [ca.densify(ca.vertcat(*first))]),
            newton,
        )

    def solve(self, x: Vector, u: Vector, params: Any) -> tuple[Vector, Vector]:
        """Rates, where these are implicit, and algebraic variables; NaN where Newton's method finds none.

        Raises
        ------
        ParameterError
            For JAX, which cannot differentiate them.
        """
        p = [getattr(params, name) for name in self._names]
        if is_traced(*(v for v in (x, u) if not is_symbolic(v)), *p):
            raise ParameterError("equations that are solved work on numbers and CasADi's symbols, not on JAX's arrays")
        if is_symbolic(x, u, *p):
            y = self._solved(_symbols(x), _symbols(u), ca.vertcat(*p))
        else:
            x, u = np.asarray(x, dtype=float), np.asarray(u, dtype=float)
            many = x.shape[1] if x.ndim > 1 else 1
            u = np.broadcast_to(u.reshape(len(u), -1), (len(u), many))
            y = self._solved.map(many)(x.reshape(len(x), many), u, np.tile(np.reshape(p, (-1, 1)), (1, many))).full()
            y = y if x.ndim > 1 else y[:, 0]
        return y[: self._n_rates], y[self._n_rates :]


def _symbols(given: Any) -> Any:
    return given if is_symbolic(given) else stack(list(given)) if len(given) else ca.DM(0, 1)


def _column(given: Any, count: int, what: str, per: str) -> Any:
    """Residuals as a column.

    Raises
    ------
    ParameterError
        If they are not so many.
    """
    column = given if is_symbolic(given) else ca.vertcat(*given)
    if column.numel() != count:
        raise ParameterError(
            f"{what} gives {column.numel()} residuals; expected {count}, one for each {per}, that are zero"
        )
    return column
