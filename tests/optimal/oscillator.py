"""A van der Pol oscillator that is to be brought to rest; left alone it swings for ever."""

import numpy as np

import slipangle as sa

START = np.array([0.0, 1.0])


def van_der_pol(stages, solver, **settings):
    """A controller that looks so many stages of 0.1 s ahead."""
    model = sa.Ode(
        f=lambda x, u, p: [(1 - x[1] ** 2) * x[0] - x[1] + u[0], x[0]],
        states=("rate", "place"),
        inputs=("u",),
        params={},
        dt=0.1,
    )
    return sa.MPC(
        model,
        horizon=stages,
        Q=sa.Weights(rate=1.0, place=1.0),
        R=sa.Weights(u=1.0),
        limits=sa.Limits(u=(-0.75, 1.0), rate=(-0.25, np.inf)),
        solver=solver,
        **settings,
    )
