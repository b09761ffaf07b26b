"""Numbers without vehicles: integrators, least squares, covariances, threads."""
