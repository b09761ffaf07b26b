"""Cars and tracks of the tests of laps."""

import numpy as np

from slipangle.optimal.lap.car import LapCar
from slipangle.paths.path import Path

RACER = LapCar(
    **dict(mass=1200.0, inertia_z=1500.0, wheelbase=2.7, l_f=1.4, C_f=1.6e5, C_r=2.2e5, mu_f=1.3, mu_r=1.4),
    **dict(power=1.2e5, drag=0.7, downforce_f=0.3, downforce_r=0.5, width=1.9, brake_rear=0.4),
)

SALOON = LapCar(
    **dict(
        mass=1093.3, inertia_z=1791.6, wheelbase=2.579, l_f=1.156, C_f=129000.0, C_r=124000.0, mu_f=0.979, mu_r=0.999
    ),
    **dict(shape=1.36, friction_load=0.033, stiffness_load=0.167, transfer_x=0.226, transfer_f=0.244, transfer_r=0.179),
    **dict(
        brake_rear=0.34, drag=0.39, power=77300.0, drive_force=3490.0, brake_force=12570.0, rolling_resistance=0.012
    ),
    **dict(mu_x=1.124, width=1.59, delta_max=0.7, even=1.0),
)


def point_like(mu, power=1e6, drag=0.0):
    """A car that is as near to a mass point as it gets: balanced, no load transfer, stiff tires, all wheels driven."""
    return LapCar(
        **dict(mass=1000.0, inertia_z=800.0, wheelbase=2.5, l_f=1.25, C_f=3e5, C_r=3e5, mu_f=mu, mu_r=mu, shape=1.4),
        **dict(friction_load=0.0, stiffness_load=0.0, transfer_x=0.0, transfer_f=0.0, transfer_r=0.0),
        **dict(drive_rear=0.5, brake_rear=0.5, power=power, drag=drag, width=1.0, force_rate=100.0),
    )


def circuit(mirrored=False, width=5.0, points=200):
    """A closed track with corners to both sides."""
    angle = np.linspace(0, 2 * np.pi, points)[:-1]
    r = 80 + 25 * np.cos(2 * angle) + 10 * np.cos(3 * angle)
    side = -1.0 if mirrored else 1.0
    return Path.from_points(
        r * np.cos(angle), side * r * np.sin(angle), closed=True, right=width, left=width, name="circuit"
    )


def ring(radius=50.0, width=4.0):
    """A circle, driven to the left."""
    angle = np.linspace(0, 2 * np.pi, 100)[:-1]
    return Path.from_points(
        radius * np.cos(angle), radius * np.sin(angle), closed=True, right=width, left=width, name="ring"
    )


def straight(length=400.0):
    X = np.linspace(0.0, length, 20)
    return Path.from_points(X, 0 * X, right=4.0, left=4.0, name="straight")
