"""Settings check themselves from what stands on their fields; every estimator with ranges does."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ParameterError
from slipangle.fields import Checked, Count, NotNegative, Positive, Within
from slipangle.identify.linear.pem import PEM
from slipangle.identify.linear.subspace import Subspace
from slipangle.identify.networks.problem import Stage


@dataclass(frozen=True)
class Settings(Checked):
    n: Count = 1
    share: Annotated[float, Within(0, 1, open="both", example="0.25")] = 0.5
    factor: Annotated[float, Within(0, 1, open="low")] = 1.0
    span: Annotated[float, Within(0.1, 2, "s")] = 1.0
    gain: Positive | None = None
    weight: NotNegative = 0.0
    lags: Count | tuple[Count, ...] = 1
    layers: tuple[Count, ...] = (3,)
    kind: Literal["mean", "median"] = "mean"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"n": 0}, "n is 0; expected a whole number of at least 1"),
        ({"n": 1.5}, "n is 1.5; expected a whole number of at least 1"),
        ({"n": True}, "n is True; expected a whole number of at least 1"),
        ({"share": 1.0}, "share is 1.0; expected a number above 0 and below 1, such as 0.25"),
        ({"share": np.nan}, "share is nan; expected a number above 0 and below 1, such as 0.25"),
        ({"factor": 0}, "factor is 0; expected a number above 0 and at most 1"),
        ({"span": 5.0}, "span is 5.0; expected a number from 0.1 to 2 s"),
        ({"gain": -1.0}, "gain is -1.0; expected a positive number, or None"),
        ({"weight": "much"}, "weight is 'much'; expected a number of at least 0"),
        ({"lags": (2, 0)}, "lags is (2, 0); expected a whole number of at least 1"),
        ({"layers": [4, 0]}, "layers is (4, 0); expected a whole number of at least 1"),
        ({"kind": "medina"}, "kind is 'medina'; nearest are 'median', 'mean': use one of these"),
    ],
)
def test_what_got_expected(wrong, said):
    with pytest.raises(ParameterError) as error:
        Settings(**wrong)
    assert str(error.value) == said


def test_what_fits_is_kept():
    given = Settings(n=np.int64(3), gain=2, lags=(1, 2), layers=[4, 5], kind="median", factor=1)
    assert (given.layers, given.lags, given.gain) == ((4, 5), (1, 2), 2)
    assert Settings(layers=range(1, 3)).layers == (1, 2)
    assert Settings(layers=7).layers == (7,)


def test_estimators_check_their_fields():
    kinds = (sa.ARX, sa.RLS, sa.NARX, sa.NeuralStateSpace, sa.Joint, sa.Hybrid, sa.Lure, sa.StateSpace, PEM, Subspace)
    for kind in (*kinds, Stage):
        assert issubclass(kind, Checked), kind
    with pytest.raises(ParameterError, match=r"^holdout is 0.9; expected a number from 0 to 0.5, such as 0.15$"):
        sa.NARX(na=1, nb=1, holdout=0.9)
    with pytest.raises(ParameterError, match=r"^activation is 'relu'; .*: use one of these$"):
        sa.NARX(na=1, nb=1, activation="relu")
