"""Where a race starts: rolling on a straight, where a car with straight wheels stays on its line."""

from types import SimpleNamespace

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.racing.sensing import NOISE
from slipangle.simulate import race as racing
from slipangle.simulate.race import CALM, _straight, race
from tests.control.racing.test_racer import FRICTION, MARGIN, PEDALS, believed, car_on, circuit, first_lap


def lap_of(turning, force):
    return SimpleNamespace(v_x=np.full(len(turning), 20.0), r=np.array(turning) / 20.0, F_x=np.array(force))


@pytest.mark.parametrize(
    ("turning", "force", "begin"),
    [
        ([8.0, 0.5, 8.0, 0.5, 0.5, 0.5], [1.0] * 6, 3),  # two points before the line at the latest
        ([8.0, 0.5, 0.7, -0.9, -5.0, 0.0], [1.0] * 6, 2),
        ([-8.0, 0.5, 0.5, 0.5, 0.0, 0.0], [1.0, 1.0, -1.0, -1.0, 0.0, 0.0], 1),  # not where it brakes
        ([8.0, 5.0, -3.0, 6.0, 7.0, 0.0], [1.0] * 6, 2),  # it never comes to rest
    ],
)
def test_it_starts_where_the_lap_last_goes_straight_on(turning, force, begin):
    assert _straight(lap_of(turning, force)) == begin


@pytest.mark.skipif(compiler() is None, reason=sentence())
def test_from_there_it_keeps_to_its_line_and_counts_no_lap_too_many(monkeypatch):
    """Put down before the start line, which here lies in a bend, as far before as it is straight."""
    monkeypatch.setattr(racing, "PATIENCE", 0.12)
    lap = first_lap()
    turning = np.abs(lap.v_x * lap.r)
    assert turning[-3] > CALM * turning.max()
    racer = sa.Racer(believed(), circuit(), PEDALS, lap=lap, margin=MARGIN, between="sectors")
    noise = sa.Values(**NOISE)
    found = race(racer, sa.Plant(car_on(FRICTION), noise=noise, seed=1), 1)
    begin = float(lap.s[_straight(lap)]) - racer.track.length
    assert begin < -5.0
    assert found.run.s[0] == pytest.approx(begin, abs=0.5)
    early = found.run.s < 0.5 * begin
    expected = np.interp(found.run.s[early], np.concatenate([lap.s - racer.track.length, lap.s]), np.tile(lap.n, 2))
    assert np.abs(found.run.e_y[early] - expected).max() < 0.3
    assert found.run.inside
    assert not found.laps
