"""The drawing from above: one scale, Y upwards, the car's corners where they are."""

import json
import re

import numpy as np
import pytest

from slipangle.errors import ParameterError
from slipangle.report import Body, Page, Section
from slipangle.report.drawing import seen_from_above
from slipangle.report.playback import Playback


def points(path):
    return np.array([[float(v) for v in p.split()] for p in re.split("[ML]", path.rstrip("Z"))[1:]])


def test_cars_are_rectangles_of_their_size_where_the_path_is():
    X = np.linspace(0.0, 40.0, 81)
    Y, psi = 0.5 * X, np.full(81, np.arctan(0.5))
    svg = seen_from_above(X, Y, psi, body=Body(front=2.0, rear=1.0, width=1.6), outlines=5, label="a <b>")
    cars = [points(d) for d in re.findall(r'class="car" d="(.*?)"', svg)]
    assert len(cars) == 5
    for corners in cars:
        sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        assert sides == pytest.approx([1.6, 3.0, 1.6, 3.0], abs=0.02)
    way = points(re.search(r'class="way" d="(.*?)"', svg).group(1))
    assert np.ptp(way, axis=0) == pytest.approx([40.0, 20.0], abs=0.02)
    assert way[-1, 1] < way[0, 1]  # to the left is up
    ahead = cars[0][:2].mean(axis=0) - way[0]
    assert ahead == pytest.approx([2.0 * np.cos(psi[0]), -2.0 * np.sin(psi[0])], abs=0.02)
    assert 'aria-label="a &lt;b&gt;"' in svg


def test_gaps_lift_the_pen():
    lane = np.array([[0.0, 1.0], [5.0, 1.0], [np.nan, np.nan], [8.0, 1.0], [9.0, 1.0]])
    t = np.linspace(0.0, 10.0, 11)
    svg = seen_from_above(t, 0 * t, 0 * t, left=lane)
    [drawn] = re.findall(r'class="lane" d="(.*?)"', svg)
    assert drawn.count("M") == 2


def test_bad_input_gets_a_sentence():
    with pytest.raises(ParameterError, match="'Y' has 2 samples"):
        seen_from_above(np.zeros(3), np.zeros(2), np.zeros(3))
    with pytest.raises(ParameterError, match="not finite"):
        seen_from_above(np.full(3, np.nan), np.zeros(3), np.zeros(3))


def drive():
    X = np.linspace(-3.0, 17.0, 21)
    Y, psi = 0.5 * X, np.full(21, np.arctan(0.5))
    body = Body(front=2.0, rear=1.0, width=1.6)
    return Playback(
        title="A drive",
        svg=seen_from_above(X, Y, psi, body=body, moving=True),
        t=(0.05 * np.arange(21)).tolist(),
        X=X.tolist(),
        Y=Y.tolist(),
        psi=psi.tolist(),
        said=[f"frame {k} </script>" for k in range(21)],
        horizon=[[x, 0.5 * x, x + 2.0, 0.5 * x + 1.0] for x in X],
    )


def test_a_drive_that_plays_has_its_frames_and_its_controls():
    page = Page(title="t", sections=(Section(title="s", blocks=(drive(),)),))
    text = page.to_html()
    assert 'max="20" value="0"' in text
    assert text.count("</script>") == 3  # settings, frames, the page's own: what is said ends none
    [frames] = re.findall(r'class="frames">(.*?)</script>', text)
    assert json.loads(frames)["X"][7] == 4.0
    assert 'class="now"' not in seen_from_above(np.arange(2.0), np.zeros(2), np.zeros(2))
