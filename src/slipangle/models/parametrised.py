"""`Parametrised`: what lets a fit vary a model's parameters by name."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.ops import Vector
from slipangle.units import SI

if TYPE_CHECKING:
    from slipangle.models.vehicles import OdeModel


class Parametrised:
    """Mixin of models made of an ODE and named parameters; the fits of `slipangle.identify.greybox` take these.

    A wrapper that changes what drives the ODE overrides `ode`, `drive_rows` and `drive`, and `si`, `value` and
    `with_values` for parameters of its own.
    """

    params: Any
    fit_info: Any

    @property
    def ode(self) -> OdeModel:
        """The ODE without what is wrapped around it."""
        return self  # type: ignore[return-value]

    def si(self, name: str) -> SI:
        """Unit, meaning and range of one parameter.

        Raises
        ------
        ParameterError
            If there is no such parameter; the nearest names are given.
        """
        return self.params.si(name)

    def value(self, name: str) -> float:
        """Value of one parameter, SI units."""
        self.si(name)
        return float(getattr(self.params, name))

    def with_values(self, **values: Any) -> Self:
        """A copy with some parameters replaced (numbers or symbols); it is no fit any more, so has no `fit_info`."""
        return replace(self, params=self.params.with_values(**values), fit_info=None)  # type: ignore[type-var]

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Every parameter."""
        return tuple(self.params.metadata())

    def drive_rows(self, data: Dataset) -> np.ndarray:
        """What drives the ODE, one row per sample from sample ``memory - 1`` on; `drive` makes its inputs of a row."""
        return data.u

    def drive(self, row: Vector) -> Vector:
        """Inputs of the ODE from one row of `drive_rows`."""
        return row

    def for_experiment(self, index: int) -> Self:
        """The model with the parameters that were fitted for one experiment of the training data.

        Parameters
        ----------
        index : int
            Place of the experiment in the training data, from 0.

        Raises
        ------
        ParameterError
            If no parameter was fitted per experiment, or there was no such experiment.
        """
        info = self.fit_info
        fitted = {} if info is None else dict(zip(info.names, map(float, info.values), strict=True))
        tag = f"[{index}]"
        own = {name.removesuffix(tag): value for name, value in fitted.items() if name.endswith(tag)}
        if not own:
            several = [n for n in fitted if n.endswith("]")]
            raise ParameterError(
                f"the model has no parameters of experiment {index}; expected one of {several or 'none'}: fit with "
                "per_experiment=(...), and count experiments from 0"
            )
        return replace(self.with_values(**own), fit_info=info)  # type: ignore[type-var]
