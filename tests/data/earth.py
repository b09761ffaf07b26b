"""Latitude and longitude of places on a map, on the ellipsoid that satellite receivers have."""

import numpy as np

FLATTENING = 1 / 298.257223563  # WGS 84


def degrees_of(X, Y, lat, lon):
    """Latitude and longitude [deg] of places east and north [m] of an origin [deg], by its radii of curvature."""
    square = FLATTENING * (2 - FLATTENING)
    across = 6378137.0 / np.sqrt(1 - square * np.sin(np.radians(lat)) ** 2)
    along = across * (1 - square) / (1 - square * np.sin(np.radians(lat)) ** 2)
    return lat + np.degrees(Y / along), lon + np.degrees(X / (across * np.cos(np.radians(lat))))
