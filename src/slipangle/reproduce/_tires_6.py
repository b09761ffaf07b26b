"""Tires of the chapter 6 drives: in the plant, and by name in the prediction."""

import numpy as np

from slipangle.models.tires.neural import NeuralTire
from slipangle.models.tires.simple import Tire
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2, SOUSA_TABLE_6_8
from slipangle.reproduce import table_6_4, table_6_8
from slipangle.reproduce._chapter_6 import LookUpTire


def simulated_tires() -> tuple[Tire, dict[str, Tire]]:
    """Tires of table 6.2, and the network fitted to their curves."""
    return SOUSA_TABLE_6_2, {"Pacejka": SOUSA_TABLE_6_2, "Neural": _neural("MLP {2 2}", *table_6_4.data())}


def experimental_tires() -> tuple[Tire, dict[str, Tire]]:
    """Look-up tables of the stand-in without noise; Magic Formula of table 6.8 and a network fitted with noise."""
    neural = _neural("MLP {1 1}", *(table_6_8.stand_in(curve)[:2] for curve in ("mu_x", "mu_y")))
    return look_up_tire(), {"Pacejka": SOUSA_TABLE_6_8, "Neural": neural}


def _neural(label: str, longitudinal: tuple[np.ndarray, ...], lateral: tuple[np.ndarray, ...]) -> NeuralTire:
    fit = table_6_4.settings(label)
    return NeuralTire(longitudinal=fit.fit(*longitudinal), lateral=fit.fit(*lateral))


def look_up_tire() -> LookUpTire:
    """Tables of the stand-in without noise, every 0.01 of slip ratio and every half degree."""
    ratio, angle = np.linspace(-0.21, 0.21, 43), np.deg2rad(np.linspace(-13.0, 13.0, 53))
    return LookUpTire(
        slip_ratio=ratio,
        mu_x=SOUSA_TABLE_6_8.longitudinal(ratio),
        slip_angle=angle,
        mu_y=SOUSA_TABLE_6_8.lateral(angle),
    )
