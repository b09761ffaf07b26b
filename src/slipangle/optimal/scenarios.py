"""`Scenarios`: what may be true of the world ahead, planned for at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from slipangle.errors import ParameterError
from slipangle.optimal.arrays import short
from slipangle.shown import Brief


@dataclass(frozen=True, eq=False)
class Scenarios(Brief):
    """Several values of what is not known, with the first inputs in common: robust multi-stage control. [1]_

    The plan has a branch for every scenario, which keeps all limits; its cost is their mean by probability. The first
    inputs are the same in all, so the one that is applied now is right whichever comes true.

    Parameters
    ----------
    values : mapping of str to sequence of float
        A value for each scenario by name: of exogenous inputs, of the problem's ``parameters``, or of parameters of a
        model made of equations. SI units.
    probabilities : sequence of float, optional
        Of each scenario, with sum 1; by default all the same.
    common : int
        How many of the first inputs are common.

    Raises
    ------
    ParameterError
        If there are not two scenarios at least, or not a value of each, or probabilities make no sense.

    References
    ----------
    .. [1] S. Lucia, T. Finkler, S. Engell, Multi-stage nonlinear model predictive control applied to a semi-batch
       polymerization reactor under uncertainty, J. Process Control 23, 1306-1319, 2013.

    Examples
    --------
    >>> Scenarios({"friction": (0.6, 1.0)}, probabilities=(0.3, 0.7))
    Scenarios(values={'friction': (0.6, 1)}, probabilities=(0.3, 0.7))
    """

    values: Mapping[str, Any]
    probabilities: Any = None
    common: int = 1

    def __post_init__(self) -> None:
        if not isinstance(self.values, Mapping) or not self.values:
            raise ParameterError(
                f"the scenarios are {short(self.values)}; expected values by name, such as {{'friction': (0.6, 1.0)}}"
            )
        rows = {}
        for name, given in self.values.items():
            try:
                row = np.array(given, dtype=float)
            except (TypeError, ValueError):
                row = np.zeros(0)
            if not isinstance(name, str) or row.ndim != 1 or len(row) < 2 or not np.isfinite(row).all():
                raise ParameterError(f"scenarios of {name!r} are {short(given)}; expected two or more finite numbers")
            rows[name] = tuple(row.tolist())
        many = {len(row) for row in rows.values()}
        if len(many) > 1:
            counts = {name: len(row) for name, row in rows.items()}
            raise ParameterError(f"the scenarios have {counts} values; expected as many of each")
        n = many.pop()
        try:
            share = np.full(n, 1 / n) if self.probabilities is None else np.array(self.probabilities, dtype=float)
        except (TypeError, ValueError):
            share = np.zeros(0)
        if share.shape != (n,) or not (share > 0).all() or not abs(share.sum() - 1) < 1e-9:
            raise ParameterError(
                f"the probabilities are {short(self.probabilities)}; expected {n} positive numbers with sum 1"
            )
        if not (isinstance(self.common, int | np.integer) and self.common >= 1):
            raise ParameterError(f"common is {short(self.common)}; expected a whole number of at least 1")
        share.flags.writeable = False
        object.__setattr__(self, "values", rows)
        object.__setattr__(self, "probabilities", share)

    def __len__(self) -> int:
        return len(self.probabilities)

    @property
    def means(self) -> dict[str, float]:
        """Mean of each value by probability. SI units."""
        return {name: float(np.dot(self.probabilities, row)) for name, row in self.values.items()}
