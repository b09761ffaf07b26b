"""`contact`: what a tire patch does whose slip follows the wheel's motion with a delay."""

from typing import NamedTuple

from slipangle.models.tires.simple import Tire
from slipangle.ops import Scalar, atan, clip, fabs, maximum, sqrt

SLOW = 2.5  # m/s, below which damping of the tread keeps a standing car from swaying
DAMPING = 0.08  # s/m, slip added per slip velocity for that
SLIDING = 0.05  # slip at which the relaxation length has halved
FASTEST = 0.001  # s, least time constant of relaxation, so that a millisecond step stays stable


class Patch(NamedTuple):
    """One wheel: velocity of its centre along and across its plane [m/s], spin [rad/s], relaxed slips, load [N]..."""

    v_x: Scalar
    v_y: Scalar
    omega: Scalar
    slip: Scalar
    side: Scalar
    load: Scalar
    friction: Scalar
    camber: Scalar


class Contact(NamedTuple):
    """What a patch does: forces in the wheel's plane [N], aligning moment [N m], rates of the slips [1/s]."""

    F_x: Scalar
    F_y: Scalar
    M_z: Scalar
    slip_rate: Scalar
    side_rate: Scalar


def contact(patch: Patch, tire: Tire, relaxation_x: float, relaxation_y: float, radius: Scalar) -> Contact:
    """Forces of one tire whose slip follows the wheel's motion over the relaxation lengths.

    The slips are ``slip = (omega r - v_x) / max(|v_x|, |omega r|)`` and ``side = sin(alpha)`` once settled, either way
    the wheel rolls; both obey ``sigma slip' = slip velocity - speed slip`` (sec. 7.2), so that at standstill
    the tire is a spring and nothing is divided by the speed. A sliding tread stores no more deflection: sigma falls
    with slip as ``1 / (1 + (slip^2 + side^2) / 0.05^2)``, about as the slope of the force does, so that a car that
    skids to a stop is not thrown back. Below 2.5 m/s the tread is damped as well (sec. 8.6).

    Source: H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012.
    """
    rolling = patch.omega * radius
    speed_x = maximum(fabs(patch.v_x), fabs(rolling))
    speed = sqrt(patch.v_x * patch.v_x + patch.v_y * patch.v_y + 1e-12)
    sliding = rolling - patch.v_x
    slow = clip(1.0 - speed_x * (1.0 / SLOW), 0.0, 1.0)
    damping = DAMPING * slow * slow
    slip = patch.slip + damping * sliding
    sine = patch.side - damping * patch.v_y
    used = (patch.slip * patch.slip + patch.side * patch.side) * (1.0 / (SLIDING * SLIDING))
    length_x = maximum(relaxation_x / (1.0 + used), FASTEST * speed_x)
    length_y = maximum(relaxation_y / (1.0 + used), FASTEST * speed)
    tangent = sine / sqrt(maximum(1.0 - patch.side * patch.side, 1e-4))
    if isinstance(patch.camber, float) and patch.camber == 0.0:
        force = tire.forces(slip, atan(tangent), patch.load, friction=patch.friction)
    else:
        force = tire.forces(slip, atan(tangent), patch.load, camber=patch.camber, friction=patch.friction)
    return Contact(
        F_x=force.F_x,
        F_y=force.F_y,
        M_z=force.M_z * clip(patch.v_x * (1.0 / SLOW), -1.0, 1.0),  # the trail turns round in reverse
        slip_rate=(sliding - speed_x * patch.slip) / length_x,
        side_rate=(-patch.v_y - speed * patch.side) / length_y,
    )
