"""A whole driver in a loop as WebAssembly: what `slipangle.export.live.Live` is to an MPC, this is to a `Driver`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from slipangle.control.driver import Driver
from slipangle.control.mpc import MPC
from slipangle.control.speed.driver import SpeedDriver
from slipangle.errors import ParameterError
from slipangle.export.controllers import table
from slipangle.export.drivers import driver_project
from slipangle.export.drives import NO_DRIVE, channels
from slipangle.export.live import Live
from slipangle.export.names import with_prefix
from slipangle.export.project import template
from slipangle.paths.path import Path


@dataclass(frozen=True, kw_only=True, eq=False)
class LiveDriver(Live):
    """A plant and a driver, which is told what instruments without errors show.

    Parameters
    ----------
    plant : Plant
        Noise and sensors of it do not count.
    whole : Driver
        With a speed law.

    Raises
    ------
    ParameterError
        If a part of the loop has no place in the page; the sentence says which.
    """

    whole: Driver
    mpc: MPC = field(init=False)
    path: Path = field(init=False)
    driver: SpeedDriver = field(init=False)

    def __post_init__(self) -> None:
        if type(self.whole.controller) is not MPC or self.whole.speed is None:
            raise ParameterError("the driver has no MPC or no speed law; expected both: show the recorded loop")
        for name, part in (("mpc", self.whole.controller), ("path", self.whole.path), ("driver", self.whole.speed)):
            object.__setattr__(self, name, part)
        super().__post_init__()

    def _wrong(self) -> dict[str, bool]:
        return super()._wrong() | {
            "the plant does not measure the model's outputs as states": not {*self.mpc.model.outputs, "v_x"}
            <= {*self.plant.model.states},
            "the speed law has gains over speed": False,
        }

    @property
    def weights(self) -> tuple[str, ...]:
        """What the controller weighs, by name; nothing where it is the driver's own to say how much."""
        return super().weights if self.whole._trusts else ()

    def _loop(self, now: Mapping[str, float]) -> dict[str, Any]:
        """Plant and driver, as `slipangle.simulate.drive.drive` takes them."""
        parts = self._plant_and_path(now)
        mpc, path, whole = self._weighed(now), parts.pop("path"), self.whole
        made = Driver(mpc.model, path, speed=whole.speed, controller=mpc, estimator=whole.estimator, dt=whole.dt)
        made._trusts = whole._trusts
        return {**parts, "driver": made}

    @cached_property
    def sources(self) -> dict[str, str]:
        """C of the driver and of the loop around it."""
        files = dict(driver_project(self.whole, "car", NO_DRIVE).everything)
        kept = {
            n: text
            for n, text in files.items()
            if n in ("car.h", "car.c") or n.startswith(("car_planner", "car_window"))
        }
        follow = "void car_follow(const double *line) { memcpy(LINE, line, sizeof LINE); }"
        own = kept["car.c"].replace("static const double LINE[]", "static double LINE[]", 1)
        if self.weights:
            lines = [*self._of_weights(), f"#define N_WEIGHTS {len(self.weights)}"]
            added = "\n".join([*lines, template("live_weights.c"), template("live_factors.c")])
            kept["car_planner.c"] += with_prefix(added, "car_planner")
            own = f"#define car_planner_trust car_planner_weighed\n{own}"
        else:
            follow += "\nvoid car_planner_factors(const double *factors) { (void)factors; }"
        declared = "void car_follow(const double *line);\nvoid car_planner_factors(const double *factors);"
        return {**kept, "car.c": "\n".join([own, declared, follow]), "live.c": self._live("live_driver.c")}

    def _of_controller(self) -> list[str]:
        """What the driver is told and wants."""
        plant, known = self.plant.model, (*self.plant.model.states, *self.plant.model.inputs)
        told, controls = channels(self.whole), self.whole.controls
        lines = [table("CHANNELS", [known.index(n) if n in known else -1 for n in told], "int")]
        return [*lines, table("COMMANDS", [controls.index(n) for n in plant.inputs], "int")]

    def _of_model(self) -> list[Any]:
        return []
