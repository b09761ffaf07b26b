"""Lanes of CommonRoad scenarios, written here as the format says, and tracks as TUM publishes them."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import FormatError, MissingFileError, ParameterError, SlipangleError


def bound(name, points):
    inner = "".join(f"<point><x>{x:.6f}</x><y>{y:.6f}</y></point>" for x, y in points)
    return f"<{name}>{inner}</{name}>"


def arc(radius, a, b, n):
    angle = np.linspace(a, b, n)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def lanelet(number, a, b, *follows, radius=50.0, width=4.0, left=12, right=12):
    """A piece of a circle driven to the left: the left bound is the inner one."""
    inner, outer = arc(radius - width / 2, a, b, left), arc(radius + width / 2, a, b, right)
    next_ones = "".join(f'<successor ref="{f}"/>' for f in follows)
    return f'<lanelet id="{number}">{bound("leftBound", inner)}{bound("rightBound", outer)}{next_ones}</lanelet>'


def scenario(tmp_path, *lanelets):
    path = tmp_path / "road.xml"
    path.write_text(f'<?xml version="1.0"?>\n<commonRoad commonRoadVersion="2020a">{"".join(lanelets)}</commonRoad>')
    return path


def test_a_lane_of_a_circle(tmp_path):
    """Two quarters of a circle, the second listed first: radius, length and width are those of the circle."""
    road = scenario(tmp_path, lanelet(7, np.pi / 2, np.pi, left=20, right=20), lanelet(3, 0, np.pi / 2, 7))
    path = sa.Path.from_file(road)
    assert not path.closed
    assert path.length == pytest.approx(np.pi * 50, rel=1e-3)
    assert path.curvature[20:-20] == pytest.approx(1 / 50, rel=0.02)
    assert (path.X[0], path.Y[0]) == pytest.approx((50, 0), abs=1e-3)
    assert path.right == pytest.approx(2.0, abs=1e-3)
    assert path.left == pytest.approx(2.0, abs=1e-3)


def test_a_closed_lane_and_bounds_of_different_counts(tmp_path):
    pieces = [lanelet(k + 1, k, k + 1, (k + 1) % 6 + 1, left=15, right=25) for k in range(6)]
    last = lanelet(6, 5, 2 * np.pi, 1, left=15, right=25)
    path = sa.Path.from_file(scenario(tmp_path, *pieces[:5], last))
    assert path.closed
    assert path.length == pytest.approx(2 * np.pi * 50, rel=1e-3)


def test_forks_and_several_beginnings_are_asked_for(tmp_path):
    road = scenario(
        tmp_path, lanelet(1, 0, 1, 2, 3), lanelet(2, 1, 2), lanelet(3, 1, 1.5), lanelet(4, 0, 1, radius=60.0)
    )
    with pytest.raises(
        ParameterError, match=r"begins at 2 lanelets, 1, 4; expected one: say which with lanelets=\(1,\)"
    ):
        sa.Path.from_file(road)
    with pytest.raises(ParameterError, match=r"after lanelet 1 .* come 2, 3; expected one"):
        sa.Path.from_file(road, lanelets=(1,))
    assert sa.Path.from_file(road, lanelets=(1, 3)).length == pytest.approx(75, rel=0.01)
    assert sa.Path.from_file(road, lanelets=[4]).length == pytest.approx(60, rel=0.01)
    with pytest.raises(ParameterError, match=r"lanelet 2 .* does not follow 3; expected none"):
        sa.Path.from_file(road, lanelets=(3, 2))
    with pytest.raises(ParameterError, match=r"has no lanelet 9; expected one of 1, 2, 3, 4"):
        sa.Path.from_file(road, lanelets=(9,))


@pytest.mark.parametrize(
    "text",
    [
        "<commonRoad></commonRoad>",
        "<commonRoad><lanelet id='1'></lanelet></commonRoad>",
        "<commonRoad><lanelet></lanelet></commonRoad>",
        "<commonRoad><lanelet id='1'>",
        "<!DOCTYPE a [<!ENTITY b 'c'>]><commonRoad/>",
        "<commonRoad><lanelet id='1'><leftBound><point><x>1</x></point><point/></leftBound></lanelet></commonRoad>",
    ],
)
def test_damaged_scenarios(tmp_path, text):
    path = tmp_path / "road.xml"
    path.write_text(text)
    with pytest.raises(FormatError):
        sa.Path.from_file(path)


def test_what_is_no_scenario(tmp_path):
    with pytest.raises(MissingFileError, match=r"no\.xml"):
        sa.Path.from_file(tmp_path / "no.xml")
    path = tmp_path / "track.csv"
    path.write_text("1,2\n3,4\n5,7\n9,9\n")
    with pytest.raises(ParameterError, match="lanelets are those of a CommonRoad scenario"):
        sa.Path.from_file(path, lanelets=(1,))
    with pytest.raises(SlipangleError, match=r"a road and no log.*Path.from_file"):
        sa.read(scenario(tmp_path, lanelet(1, 0, 1)))


HEADS = {
    "TUM": ("# x_m,y_m,w_tr_right_m,w_tr_left_m", False),
    "left first": ("# x_m,y_m,w_tr_left_m,w_tr_right_m", True),
    "no comment": ("x_m,y_m,w_tr_right_m,w_tr_left_m", False),
    "no comment, left first": ("x,y,left,right", True),
    "none": ("# made by hand", False),
}


@pytest.mark.parametrize("name", HEADS)
def test_widths_are_where_the_headings_say(name, tmp_path):
    head, swapped = HEADS[name]
    rows = [f"{x:.3f},{y:.3f},3.0,5.0" for x, y in arc(40, 0, 3, 30)]
    path = tmp_path / "track.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    read = sa.Path.from_file(path)
    assert np.unique(np.round(read.right, 9)).tolist() == [5.0 if swapped else 3.0]
    assert np.unique(np.round(read.left, 9)).tolist() == [3.0 if swapped else 5.0]
