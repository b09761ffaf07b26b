"""The car of a job's fastest lap: one of its models, identified."""

from __future__ import annotations

from collections.abc import Mapping

from slipangle.errors import ConfigError, nearest
from slipangle.models.model import Model
from slipangle.optimal.lap.car import LapCar
from slipangle.optimal.lap.cars import car_and_supposed, known_limits
from slipangle.workflow.job import identify_named
from slipangle.workflow.log import read_logs
from slipangle.workflow.settings import Settings


def identified_car(settings: Settings, name: str | None, values: Mapping[str, float]) -> tuple[Model, LapCar, str]:
    """A model of the job, by default the first that knows what its tires can hold, and its car with given values.

    Then a sentence on what neither says of the car, see `slipangle.optimal.lap.cars.car_and_supposed`.

    Raises ConfigError if the job has no such model, and ParameterError as `lap_car`.
    """
    names = [m.name for m in settings.model]
    if name is not None and name not in names:
        raise ConfigError(f"the job has no model '{name[:60]}'; {nearest(name, names)}")
    logs = read_logs(settings)
    for one in names if name is None else [name]:
        model = identify_named(settings, one, logs)
        if name is not None or known_limits(model) or known_limits(getattr(model, "params", None)):
            return model, *car_and_supposed(model, values)
    raise ConfigError(
        f"none of the job's models ({', '.join(names)[:100]}) says how much its tires can hold; expected a nonlinear "
        "or saturating bicycle: add a [[model]] of that kind"
    )
