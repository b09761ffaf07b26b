"""Metrics, units and path geometry in plain NumPy. L. C. Sousa, PhD thesis, PUC-Rio, 2023 (S)."""

import math

import numpy as np

# value in SI of one unit, from its definition
UNITS = {
    "%": 1 / 100,
    "ms": 1 / 1000,
    "us": 1 / 1000**2,
    "ns": 1 / 1000**3,
    "min": 60,
    "h": 60 * 60,
    "d": 24 * 60 * 60,
    "kHz": 1000,
    "mm": 1 / 1000,
    "cm": 1 / 100,
    "km": 1000,
    "in": 0.0254,
    "ft": 12 * 0.0254,
    "mi": 5280 * 12 * 0.0254,
    "l": (1 / 10) ** 3,
    "1/km": 1 / 1000,
    "km/h": 1000 / 3600,
    "mph": 5280 * 12 * 0.0254 / 3600,
    "kn": 1852 / 3600,
    "ft/s": 12 * 0.0254,
    "mm/s": 1 / 1000,
    "cm/s": 1 / 100,
    "g": 9.80665,
    "mrad": 1 / 1000,
    "deg": 2 * math.pi / 360,
    "deg/s": 2 * math.pi / 360,
    "deg/s2": 2 * math.pi / 360,
    "rpm": 2 * math.pi / 60,
    "lb": 0.45359237,
    "kN": 1000,
    "lbf": 0.45359237 * 9.80665,
    "kN m": 1000,
    "ft lbf": 0.3048 * 0.45359237 * 9.80665,
    "N/deg": 360 / (2 * math.pi),
    "kPa": 1000,
    "bar": 1e5,
    "mbar": 1e5 / 1000,
    "mV": 1 / 1000,
    "kW": 1000,
    "hp": 550 * 0.3048 * 0.45359237 * 9.80665,
    "psi": 0.45359237 * 9.80665 / 0.0254**2,
}


def rmse(y, y_hat):
    """S 4-10."""
    return math.sqrt(sum((a - b) ** 2 for a, b in zip(y, y_hat, strict=True)) / len(y))


def r2(y, y_hat):
    """S 4-11."""
    mean = sum(y) / len(y)
    return 1 - sum((a - b) ** 2 for a, b in zip(y, y_hat, strict=True)) / sum((a - mean) ** 2 for a in y)


def fit(y, y_hat):
    """S 4-12, percent."""
    mean = sum(y) / len(y)
    error = math.sqrt(sum((a - b) ** 2 for a, b in zip(y, y_hat, strict=True)))
    return 100 * (1 - error / math.sqrt(sum((a - mean) ** 2 for a in y)))


def vaf(y, y_hat):
    """S 4-13, percent: both variances are about their own means, so a constant offset does not count."""

    def variance(values):
        mean = sum(values) / len(values)
        return sum((v - mean) ** 2 for v in values) / len(values)

    return 100 * (1 - variance([a - b for a, b in zip(y, y_hat, strict=True)]) / variance(y))


def seen_from_the_path(X, Y, psi, foot):
    """Errors of a pose against a pose of the path: ahead of it, to its left, turned to the left of it."""
    way = complex(X - foot[0], Y - foot[1]) * np.exp(-1j * foot[2])
    return way.real, way.imag, (psi - foot[2] + math.pi) % (2 * math.pi) - math.pi


def ellipse(a, b, t):
    """Point, heading and curvature of an ellipse that is driven to the left, by its parameter t."""
    X, Y = a * np.cos(t), b * np.sin(t)
    dX, dY, ddX, ddY = -a * np.sin(t), b * np.cos(t), -a * np.cos(t), -b * np.sin(t)
    return X, Y, np.arctan2(dY, dX), (dX * ddY - dY * ddX) / np.hypot(dX, dY) ** 3


def fastest_in_a_bend(s, v, curvature, a_y, a_x):
    """Speed after ``s`` metres on a bend, speeding up from ``v`` with what cornering leaves of the friction ellipse.

    With w = v^2 curvature / a_y, the used share of a_y, v v' = a_x sqrt(1 - w^2) becomes w' = 2 curvature a_x / a_y
    sqrt(1 - w^2), so w is a sine until it reaches 1.
    """
    turned = np.arcsin(v * v * curvature / a_y) + 2 * curvature * a_x / a_y * s
    return np.sqrt(a_y / curvature * np.sin(np.minimum(turned, np.pi / 2)))
