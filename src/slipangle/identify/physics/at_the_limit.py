"""`KnownCar`: what is known of a car, and the nonlinear bicycle that a network starts from, fitted from that alone."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Annotated

from slipangle.data.dataset import Dataset
from slipangle.errors import IdentifiabilityWarning, MissingColumnError, ParameterError
from slipangle.fields import Checked, Within
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
from slipangle.models.vehicles.parameters import GRAVITY, IMPOSSIBLE, weight_doubt

FREE = (
    *("C_f", "C_r", "inertia_z", "mu_f", "mu_r", "steering_lag", "steering_offset", "bias_r"),
    *("l_f", "transfer_x", "friction_load", "stiffness_load"),
)
_STEP = 0.017  # longest step of the integrator that follows an ordinary steering lag [s]
_STIFF_F, _STIFF_R = 10.0, 12.0  # cornering stiffness over the axle's load, of ordinary tires [1/rad]
_DRAG = 9.8e-4  # of ordinary cars, over mass per wheelbase [-]

Mass = Annotated[float, Within(1e-3, 1e5, "kg")]
Wheelbase = Annotated[float, Within(0.01, 20.0, "m")]
ToFrontAxle = Annotated[float, Within(1e-3, 15.0, "m")]
Gain = Annotated[float, Within(-20.0, 20.0)]


@dataclass(frozen=True, kw_only=True)
class KnownCar(Checked):
    """A car of which mass and geometry are known; estimators that start from physics take these in place of a model.

    Parameters
    ----------
    mass : float, optional
        Of the car as it was driven. [kg]
    wheelbase : float, optional
        From axle to axle. [m]
    l_f : float, optional
        From the centre of gravity to the front axle. [m]
    steering_gain : float
        Road-wheel angle per logged angle, such as 1/15 for a hand wheel; negative turns the sign.
    """

    mass: Mass | None = None
    wheelbase: Wheelbase | None = None
    l_f: ToFrontAxle | None = None
    steering_gain: Gain = 1.0

    def check_known(self, given: object, name: str) -> None:
        """Raise ParameterError unless either a model is given or what one is fitted from, and the car is possible."""
        known = {"mass": self.mass, "wheelbase": self.wheelbase, "l_f": self.l_f}
        missing = [key for key, value in known.items() if value is None]
        if given is None and missing:
            raise ParameterError(
                f"neither {name} nor {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} given; expected a "
                f"model to start from, or mass, wheelbase and l_f, from which it is fitted: add {', '.join(missing)}"
            )
        if given is not None and len(missing) < len(known):
            said = ", ".join(key for key in known if key not in missing)
            raise ParameterError(f"{name} is given, and {said} too; expected one of both: the model has them")
        if self.wheelbase is not None and self.l_f is not None and not self.l_f < self.wheelbase:
            raise ParameterError(
                f"l_f is {self.l_f:g} m and the wheelbase {self.wheelbase:g} m; expected the centre of gravity between "
                "the axles: check both, and their units"
            )
        if self.wheelbase is not None and self.mass is not None:
            said = weight_doubt(self.mass, self.wheelbase, beyond=IMPOSSIBLE)
            if said:
                raise ParameterError(said)

    def bicycle(self, data: Dataset) -> NonlinearBicycle:
        """The nonlinear bicycle of the yaw rate, twelve free parameters fitted from many starts by `GreyBox`.

        What the data leave undetermined stands in its ``fit_info.warnings``.

        Raises MissingColumnError if a channel is missing, ExcitationError or TooShortError if the data cannot tell.
        """
        require_channels(data)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", IdentifiabilityWarning)
            return GreyBox(start=self.guess(data.dt), free=FREE).fit(data)

    def guess(self, dt: float) -> NonlinearBicycle:
        """A car of ordinary tires for its size, at a sample time [s]."""
        mass, wheelbase, l_f = (float(value or 0.0) for value in (self.mass, self.wheelbase, self.l_f))
        load, l_r = GRAVITY * mass / wheelbase, wheelbase - l_f
        params = NonlinearBicycleParams(
            **dict(mass=mass, wheelbase=wheelbase, l_f=l_f, inertia_z=mass * l_f * l_r),
            **dict(C_f=_STIFF_F * load * l_r, C_r=_STIFF_R * load * l_f, drag=_DRAG * mass / wheelbase),
            steering_gain=self.steering_gain,
        )
        return NonlinearBicycle(params=params, dt=dt, substeps=max(1, math.ceil(dt / _STEP)))


def require_channels(data: Dataset) -> None:
    """Raise MissingColumnError unless steering, speed, its derivative and the yaw rate are there."""
    for name in ("delta", "v_x", "r"):
        if name not in data:
            raise MissingColumnError(
                f"'{data.name}' has no channel '{name}'; expected delta, v_x and r: name the columns so when reading "
                "the log"
            )
    if "v_x_dot" not in data:
        raise MissingColumnError(
            f"'{data.name}' has no channel 'v_x_dot', the derivative of v_x; expected it beside delta, v_x and r: "
            "data = sa.with_speed_derivative(data)"
        )
