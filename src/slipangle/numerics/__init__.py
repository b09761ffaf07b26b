"""Numbers without vehicles: integrators, `least_squares` and its `covariance`, many starts, BLAS threads."""
