"""The guard of training: luck on the held-out part alone never replaces the start."""

from dataclasses import dataclass

import numpy as np
import pytest

from slipangle.identify.networks.problem import Stage
from slipangle.identify.networks.training import train

ASTRAY = 2.0


@dataclass(frozen=True)
class Lucky:
    """Training pulls the one parameter from 0 to 3; the held-out score only falls, the free run on the training data
    is the start's own until the parameter comes beyond `ASTRAY`."""

    astray: float = ASTRAY

    def loss(self, params, arrays, starts, horizon):
        return (params[0] - 3.0) ** 2

    def score(self, params, arrays):
        return 5.0 - params[0]

    def own(self, params, arrays):
        return 1.0 + (params[0] > self.astray)


def trained(guarded, astray=ASTRAY):
    stage = Stage(epochs=60, learning_rate=0.5)
    start = (np.array(0.0),)
    problem = Lucky(astray=astray)
    return train(problem, lambda seed: start, (), lambda h: np.arange(5), stages=(stage,), seeds=(0,), guarded=guarded)


def test_parameters_that_go_astray_on_their_own_training_data_are_not_chosen():
    assert trained(guarded=False).params[0] > ASTRAY
    found = trained(guarded=True)
    assert 0 < found.params[0] <= ASTRAY
    assert found.best.score == pytest.approx(5.0 - found.params[0], rel=1e-6)
    assert found.best.score == found.best.curve[:, 1].min()
    assert not found.warnings


def test_where_all_go_astray_the_start_stays_and_a_note_says_so():
    found = trained(guarded=True, astray=0.0)
    assert found.params[0] == 0.0
    assert found.best.epoch == 0
    assert found.warnings == ("seed 0: training never improved on the random start",)
