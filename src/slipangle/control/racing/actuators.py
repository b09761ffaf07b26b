"""`Actuators`: what a racer asks of its steering and pedals, and what the car has done of it by now."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from slipangle.control.racing.pedals import Pedals
from slipangle.optimal.lap.car import LapCar


class Actuators:
    """Steering and pedals of a car, one sample at a time.

    The angle that is asked for reaches the steering after a delay, and the road wheels follow it with a lag. What is
    asked along the car waits as long before it is passed to the pedals, so that a plan of both begins where both are
    heard; forces follow it as the pedals do.

    Parameters
    ----------
    car : LapCar
        Its limits of steering angle and brakes.
    pedals : Pedals
        What they do, and how late.
    delay, lag : float
        Of the steering, the delay in whole samples; see `Racer`. [s]
    sample : float
        Between calls of `ask`. [s]

    Attributes
    ----------
    asked : tuple of float
        Angle of the road wheels and force along the car, as asked for last. [rad, N]
    heard : tuple of float
        The same, as far as it has come through the delay.
    steered : float
        Angle of the road wheels. [rad]
    driving, braking : float
        Forces along the car. [N]
    """

    def __init__(self, car: LapCar, pedals: Pedals, *, delay: float, lag: float, sample: float) -> None:
        self.car, self.pedals, self.sample = car, pedals, sample
        self._behind = math.exp(-sample / lag) if lag > 0.0 else 0.0
        self._coming: deque[tuple[float, float]] = deque([(0.0, 0.0)] * round(delay / sample))
        self.asked = self.heard = (0.0, 0.0)
        self.steered = self.driving = self.braking = 0.0

    @property
    def force(self) -> float:
        """Along the car. [N]"""
        return self.driving + self.braking

    @property
    def coming(self) -> np.ndarray:
        """Rates of angle and force on their way, [rad/s, N/s], shape (n, 2): n samples of the delay."""
        return np.diff([self.heard, *self._coming], axis=0) / self.sample

    def ask(self, turn: float, rise: float, v_x: float, most: float, gear: int) -> tuple[float, float]:
        """Throttle and brake [0 to 1] for a sample, in which the rates asked for are ``turn`` and ``rise``.

        Parameters
        ----------
        turn, rise : float
            Of the road-wheel angle and of the force along the car. [rad/s, N/s]
        v_x : float
            Speed. [m/s]
        most : float
            Force at full throttle. [N]
        gear : int
            The car is in.
        """
        car, dt, pedals = self.car, self.sample, self.pedals
        delta, F = self.asked
        delta = min(max(delta + dt * turn, -car.delta_max), car.delta_max)
        self.asked = delta, min(max(F + dt * rise, -car.brake_force), most)
        self._coming.append(self.asked)
        delta, F = self._coming.popleft()
        self.heard = delta, min(F, most)
        self.steered = delta - self._behind * (delta - self.steered)
        throttle, brake = pedals.pressed(self.heard[1], v_x, most, gear)
        driving, braking = pedals.forces(throttle, brake, v_x, most, gear)
        self.driving += (driving - self.driving) * min(dt / max(pedals.lag, dt), 1.0)
        self.braking += (braking - self.braking) * min(dt / max(pedals.brake_lag, dt), 1.0)
        return throttle, brake
