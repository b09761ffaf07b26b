"""`Wrapper`: a model around another one."""

from dataclasses import replace
from typing import Any

from slipangle.models.model import Model, derived, taken


class Wrapper(Model):
    """What a model around another one takes over from it; subclasses are dataclasses with a field ``model``."""

    model: Any
    dt = taken("model.dt")
    inputs = taken("model.inputs")
    outputs = taken("model.outputs")
    states = taken("model.states")
    memory = taken("model.memory")
    quantities = taken("model.quantities")
    region = taken("model.region")

    @derived
    def alternatives(self) -> tuple[Model, ...]:
        """Those of the model, each as wrapped as that."""
        others = self.model.alternatives
        return (self,) if len(others) == 1 else tuple(replace(self, model=other) for other in others)  # type: ignore[type-var]
