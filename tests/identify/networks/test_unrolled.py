"""Free runs in JAX are compiled once for all networks of an architecture: seeds, folds and fits share them."""

import numpy as np
import pytest

from slipangle.identify.networks.unrolled import unrolled_lags
from slipangle.models.black_box.networks import MLP


def net(seed=0, sizes=(4, 3, 1), activation="tanh", straight=False):
    made = MLP.random(sizes, activation=activation, seed=seed)
    skip = np.full((sizes[-1], sizes[0]), 0.1) if straight else None
    return MLP(weights=made.weights, biases=made.biases, activation=activation, skip=skip)


def test_networks_of_other_weights_share_what_is_compiled():
    assert unrolled_lags(net()) is unrolled_lags(net(seed=1))


@pytest.mark.parametrize("other", [{"activation": "elu"}, {"sizes": (4, 5, 1)}, {"straight": True}], ids=str)
def test_other_architectures_do_not(other):
    assert unrolled_lags(net()) is not unrolled_lags(net(**other))


def test_the_run_is_that_of_the_weights_it_is_given():
    drives, past = np.random.default_rng(0).standard_normal((5, 2)), np.array([0.3, -0.2])
    for network in (net(), net(seed=1)):
        run, seen = np.asarray(unrolled_lags(network).run(network.parameters, past, drives)), past
        for drive, y in zip(drives, run, strict=True):
            assert y == pytest.approx(network(np.concatenate([seen, drive])[:, None])[:, 0], rel=1e-5)
            seen = np.concatenate([y, seen])[:2]
