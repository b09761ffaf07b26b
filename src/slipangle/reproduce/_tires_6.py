"""Tires of the chapter 6 drives: in the plant, and by name in the prediction."""

from __future__ import annotations

import numpy as np

from slipangle.models.tires.neural import NeuralTire
from slipangle.models.tires.simple import Tire
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2, SOUSA_TABLE_6_8
from slipangle.reproduce import table_6_4, table_6_8
from slipangle.reproduce._chapter_6 import LookUpTire


def simulated_tires() -> tuple[Tire, dict[str, Tire]]:
    """Tires of table 6.2, and the network fitted to their curves."""
    longitudinal, lateral = table_6_4.data()
    fit = table_6_4.settings("MLP {2 2}")
    neural = NeuralTire(longitudinal=fit.fit(*longitudinal), lateral=fit.fit(*lateral))
    return SOUSA_TABLE_6_2, {"Pacejka": SOUSA_TABLE_6_2, "Neural": neural}


def experimental_tires() -> tuple[Tire, dict[str, Tire]]:
    """Look-up tables of the stand-in without noise; Magic Formula of table 6.8 and a network fitted with noise."""
    fit = table_6_4.settings("MLP {1 1}")
    neural = NeuralTire(
        longitudinal=fit.fit(*table_6_8.stand_in("mu_x")[:2]), lateral=fit.fit(*table_6_8.stand_in("mu_y")[:2])
    )
    return look_up_tire(), {"Pacejka": SOUSA_TABLE_6_8, "Neural": neural}


def look_up_tire() -> LookUpTire:
    """Tables of the stand-in without noise, every 0.01 of slip ratio and every half degree."""
    ratio, angle = np.linspace(-0.21, 0.21, 43), np.deg2rad(np.linspace(-13.0, 13.0, 53))
    return LookUpTire(
        slip_ratio=ratio,
        mu_x=SOUSA_TABLE_6_8.longitudinal(ratio),
        slip_angle=angle,
        mu_y=SOUSA_TABLE_6_8.lateral(angle),
    )
