"""The multi-body car of commonroad-vehicle-models as an independent reference: its tire here, its drive there."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from slipangle.models.fast import roll_out
from slipangle.models.tires.simple import Tire, TireForces, practical_slip
from slipangle.models.vehicles.catalogue import BMW_320I
from slipangle.models.vehicles.driveline import Brakes, Differential, Driveline, Engine, Steering
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.ops import atan, clip, cos, fabs, sign, sin


@dataclass(frozen=True, kw_only=True)
class HandbookTire(Tire):
    """The reference's Magic Formula: stiffness in proportion to load, offsets that turn with the sign of camber."""

    c: SimpleNamespace

    def forces(self, slip_ratio, slip_angle, load, *, camber=0.0, friction=1.0):
        c, k = self.c, practical_slip(slip_ratio)
        alpha, camber = -slip_angle, -camber  # the reference leans the other way for a positive roll

        def curve(B, C, E, x):
            return C * atan(B * x - E * (B * x - atan(B * x)))

        D = c.p_dx1 * load + 1e-9
        F_x0 = D * sin(curve(load * c.p_kx1 / (c.p_cx1 * D), c.p_cx1, c.p_ex1, k + c.p_hx1) + load * c.p_vx1)
        side, size = sign(camber), fabs(camber)
        mu_y = c.p_dy1 * (1 - c.p_dy3 * camber * camber)
        D = mu_y * load + 1e-9
        x = alpha + side * (c.p_hy1 + c.p_hy3 * size)
        F_y0 = D * sin(curve(load * c.p_ky1 / (c.p_cy1 * D), c.p_cy1, c.p_ey1, x))
        F_y0 = F_y0 + side * load * (c.p_vy1 + c.p_vy3 * size)
        B = c.r_bx1 * cos(atan(c.r_bx2 * k))
        G_x = cos(curve(B, c.r_cx1, c.r_ex1, alpha + c.r_hx1)) / cos(curve(B, c.r_cx1, c.r_ex1, c.r_hx1))
        B = c.r_by1 * cos(atan(c.r_by2 * (alpha - c.r_by3)))
        G_y = cos(curve(B, c.r_cy1, c.r_ey1, -k + c.r_hy1)) / cos(curve(B, c.r_cy1, c.r_ey1, c.r_hy1))
        S = mu_y * load * (c.r_vy1 + c.r_vy3 * camber) * cos(atan(c.r_vy4 * alpha)) * sin(c.r_vy5 * atan(-c.r_vy6 * k))
        return TireForces(G_x * F_x0, G_y * F_y0 + S)


def reference_parameters():
    """Vehicle 2 of the reference."""
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2

    return parameters_vehicle2()


def plain(node):
    """A nested parameter record as attributes that are quick to read."""
    return SimpleNamespace(**{k: plain(v) if hasattr(v, "__dict__") else v for k, v in vars(node).items()})


def reference_run(p, v_x, delta, accel, dt=0.001):
    """States of the reference, shape (n + 1, 29); ``delta(t)`` [rad] is imposed on the wheels, ``accel(t)`` [m/s2]."""
    from vehiclemodels.init_mb import init_mb
    from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

    x = np.array(init_mb([0.0, 0.0, float(delta(0.0)), v_x, 0.0, 0.0, 0.0], p))
    n = len(accel)
    rows = [x]
    for k in range(n):
        t = k * dt

        def f(y, at, a=accel[k]):
            y = y.copy()
            y[2] = delta(at)
            return np.array(vehicle_dynamics_mb(y.tolist(), [0.0, a], p))

        k1 = f(x, t)
        k2 = f(x + dt / 2 * k1, t + dt / 2)
        k3 = f(x + dt / 2 * k2, t + dt / 2)
        k4 = f(x + dt * k3, t + dt)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        x[2] = delta(t + dt)
        rows.append(x)
    return np.array(rows)


def our_car(p, dt=0.001):
    """The same car on our side: rear drive, no losses, the reference's tire, next to no relaxation."""
    force = 20.0 * p.m * p.R_w  # N m of both pedals, more than ever asked for
    params = replace(
        BMW_320I,
        rolling_resistance=0.0,
        drag_area=0.0,
        relaxation_x=0.05,
        relaxation_y=0.05,
        steering=Steering(limit=1.0),
        brakes=Brakes(torque=force, bias=p.T_sb),
        driveline=Driveline(
            engine=Engine(speeds=(0.0,), torques=(force,)), final=1.0, front_share=p.T_se, rear=Differential()
        ),
    )
    tire = HandbookTire(c=p.tire)
    return DualTrack(params=params, tire_f=tire, tire_r=tire, dt=dt), force


def our_run(p, v_x, delta, accel, dt=0.001):
    """States of ours, shape (n + 1, n_states), and their names."""
    car, force = our_car(p, dt)
    n = len(accel)
    torque = p.m * p.R_w * np.asarray(accel)
    steered = np.array([delta((k + 0.5) * dt) for k in range(n)])
    u = np.column_stack([steered, clip(torque / force, 0.0, 1.0), clip(-torque / force, 0.0, 1.0)])
    return roll_out(car.functions[0], car.straight(v_x), u), car.states
