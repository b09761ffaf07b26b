"""Geometry of paths: exact shapes, projections, ISO lanes, speed profiles, files, bad input."""

import math

import numpy as np
import pytest

from slipangle.errors import (
    FormatError,
    MissingFileError,
    ModelWarning,
    NotFiniteError,
    ParameterError,
    SlipangleError,
    TooShortError,
)
from slipangle.paths.lane_change import double_lane_change, lane_changes, obstacle_avoidance
from slipangle.paths.path import Path
from tests.data.earth import degrees_of


def circle(radius=50.0, points=48, **options):
    angle = np.linspace(0, 2 * np.pi, points, endpoint=False)
    return Path.from_points(radius * np.cos(angle), radius * np.sin(angle), closed=True, **options)


PATHS = {
    "circle": circle(),
    "iso 3888-1": double_lane_change(20.0),
    "iso 3888-2": obstacle_avoidance(15.0),
    "lane changes": lane_changes(20.0),
    "spline": Path.from_points(np.linspace(0, 100, 12), 10 * np.sin(np.linspace(0, 4, 12))),
}
EVERY = pytest.mark.parametrize("path", PATHS.values(), ids=PATHS.keys())


@pytest.mark.parametrize("radius", [10.0, 50.0, 300.0])
@pytest.mark.parametrize("side", [1, -1])
def test_circle(radius, side):
    angle = side * np.linspace(0, 2 * np.pi, 48, endpoint=False)
    path = Path.from_points(radius * np.cos(angle), radius * np.sin(angle), closed=True)
    assert path.length == pytest.approx(2 * np.pi * radius, rel=1e-6)
    assert path.curvature == pytest.approx(side / radius, rel=1e-4)
    assert path.psi[-1] - path.psi[0] == pytest.approx(side * 2 * np.pi, abs=1e-9)


@EVERY
def test_arc_length_heading_and_curvature_agree(path):
    s = np.linspace(1.0, path.length - 1.0, 300)
    h = 1e-3
    a, b, at = path.at(s - h), path.at(s + h), path.at(s)
    assert (b.X - a.X) / (2 * h) == pytest.approx(np.cos(at.psi), abs=2e-5)
    assert (b.Y - a.Y) / (2 * h) == pytest.approx(np.sin(at.psi), abs=2e-5)
    kink = np.abs(np.diff(path.curvature, 2)).max() / 4  # curvature is linear between samples
    assert (b.psi - a.psi) / (2 * h) == pytest.approx(at.curvature, abs=1e-6 + kink)


@EVERY
@pytest.mark.parametrize("offset", [-3.0, -0.2, 0.0, 1e-6, 0.7, 4.0])
def test_projection_undoes_offsetting(path, offset):
    for s in np.linspace(5.0, path.length - 5.0, 7):
        at = path.at(s)
        X, Y = at.X[0] - offset * np.sin(at.psi[0]), at.Y[0] + offset * np.cos(at.psi[0])
        foot = path.project(X, Y, s + 3.0)
        assert foot.s == pytest.approx(s, abs=1e-6)
        assert foot.e_y == pytest.approx(offset, abs=1e-9)
        assert foot.psi == pytest.approx(at.psi[0], abs=1e-6)


def test_open_path_goes_straight_on_beyond_its_ends():
    path = double_lane_change(20.0, run_in=10.0, run_out=10.0)
    at = path.at([-5.0, path.length + 7.0])
    assert at.X == pytest.approx([path.X[0] - 5.0, path.X[-1] + 7.0])
    assert np.isinf(at.left).all()
    assert path.project(path.X[-1] + 7.0, path.Y[-1] + 0.3).s == pytest.approx(path.length + 7.0)
    assert path.project(path.X[-1] + 7.0, path.Y[-1] + 0.3, path.length - 1).e_y == pytest.approx(0.3)
    assert path.project(path.X[0] - 4.0, -0.2).s == pytest.approx(-4.0)


def test_laps_add_up_on_a_closed_path():
    path = circle()
    s, turns = 0.0, 2.5
    for angle in np.linspace(0, turns * 2 * np.pi, 200):
        foot = path.project(49.0 * math.cos(angle), 49.0 * math.sin(angle), s)
        s = foot.s
        assert foot.psi == pytest.approx(angle + np.pi / 2, abs=1e-4)
    assert s == pytest.approx(turns * path.length, rel=1e-6)
    assert path.at(s).psi[0] == pytest.approx(turns * 2 * np.pi + np.pi / 2, abs=1e-4)


def test_a_path_that_crosses_itself_is_followed_in_order():
    t = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    path = Path.from_points(60 * np.sin(t), 30 * np.sin(2 * t), closed=True)
    s = np.arange(0, path.length, 1.0)
    at = path.at(s)
    assert path.project_all(at.X, at.Y, 0.0)[:, 0] == pytest.approx(s, abs=1e-6)


# ---- ISO lanes -----------------------------------------------------------------------------------------------------


def edges(path, x_from, x_to):
    """Lateral positions of the right and left edge marked between two x."""
    right, left = path.boundaries()
    here = (path.X > x_from + 0.5) & (path.X < x_to - 0.5)
    assert np.isfinite(right[here]).all()
    return right[here, 1], left[here, 1]


@pytest.mark.parametrize("w", [1.5, 1.72, 1.8, 2.1])
def test_double_lane_change_has_the_lanes_of_iso_3888_1(w):
    path = double_lane_change(20.0, width=w)
    base = -0.5 * (1.1 * w + 0.25)
    for (a, b), up, wide in (((0, 15), 0, 1.1), ((45, 70), 3.5, 1.2), ((95, 125), 0, 1.3)):
        right, left = edges(path, a, b)
        assert right == pytest.approx(base + up, abs=1e-9)
        assert left == pytest.approx(base + up + wide * w + 0.25, abs=1e-9)
    for a, b in ((-30, 0), (15, 45), (70, 95), (125, 155)):
        here = (path.X > a + 0.3) & (path.X < b - 0.3)
        assert np.isinf(path.left[here]).all()
    assert path.Y.max() == pytest.approx(3.5 + 0.05 * w)
    assert path.Y[-1] == pytest.approx(0.1 * w)
    assert path.inside(path.X, path.Y, w).all()
    assert path.inside(path.X, path.Y, w, psi=path.psi, front=2.0, rear=2.0).all()
    assert not path.inside(path.X, path.Y + 0.1 * w + 0.13, w).all()
    assert not path.inside(path.X, path.Y - 0.1 * w - 0.13, w).all()
    assert (path.v_x == 20.0).all()


@pytest.mark.parametrize("w", [1.5, 1.8, 2.2])
def test_obstacle_avoidance_has_the_lanes_of_iso_3888_2(w):
    path = obstacle_avoidance(15.0, width=w)
    first, second, third = 1.1 * w + 0.25, w + 1.0, max(1.3 * w + 0.25, 3.0)
    for (a, b), up, wide in (
        ((0, 12), 0.0, first),
        ((25.5, 36.5), first + 1.0, second),
        ((49, 61), 0.0, third),
    ):
        right, left = edges(path, a, b)
        assert right == pytest.approx(up - 0.5 * first, abs=1e-9)
        assert left - right == pytest.approx(wide, abs=1e-9)
    assert path.inside(path.X, path.Y, w).all()


def test_blend_lowers_the_curvature_and_keeps_the_gates():
    sharp, smooth = (double_lane_change(20.0, blend=b) for b in (0.0, 5.0))
    assert np.abs(smooth.curvature).max() < 0.6 * np.abs(sharp.curvature).max()
    assert smooth.project(15.0, 0.0).e_y == pytest.approx(-0.058, abs=2e-3)  # the path is 0.06 m left at the last cones
    assert sharp.project(15.0, 0.0).e_y == pytest.approx(0.0, abs=1e-6)


def test_published_double_lane_change_agrees(real_data):
    """An independent path for a vehicle 1.72 m wide: Bezier points, x = 60 m where the first lane ends."""
    rows = np.loadtxt(real_data("tracks/iso3888/ISO_double_lane_change2.txt"), skiprows=1)
    knots, into, out = rows[:, :3], rows[:, 3:6], rows[:, 6:9]
    t = np.linspace(0, 1, 200)[:, None]
    pieces = [
        (1 - t) ** 3 * knots[i] + 3 * (1 - t) ** 2 * t * out[i] + 3 * (1 - t) * t**2 * into[i + 1] + t**3 * knots[i + 1]
        for i in range(2, 5)
    ]
    theirs = np.vstack(pieces)
    ours = double_lane_change(20.0, width=1.72, blend=0.0)
    feet = ours.project_all(theirs[:, 0] - 45.0, theirs[:, 1])
    assert np.abs(feet[:, 1]).max() < 0.054 * 3.586  # cubic there, quintic here: at most 5.4 % of the change apart
    gates = theirs[np.isin(np.round(theirs[:, 0], 6), [60.0, 90.0, 115.0, 140.0])]
    assert len(gates) >= 4
    for X, Y, _ in gates:
        assert ours.project(X - 45.0, Y).e_y == pytest.approx(0.0, abs=2e-6)  # interpolation between samples


def test_lane_changes_visit_every_offset():
    path = lane_changes(20.0, offsets=(3.5, -1.0, 0.0), change=40.0, hold=20.0)
    for k, y in enumerate((3.5, -1.0, 0.0)):
        here = (path.X > 60 * (k + 1) + 0.5) & (path.X < 60 * (k + 1) + 19.5)
        assert path.Y[here] == pytest.approx(y, abs=1e-9)


# ---- speed and preview ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("closed", [True, False])
def test_speed_profile_keeps_to_its_limits(closed):
    t = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    track = Path.from_points(200 * np.cos(t) + 20 * np.cos(3 * t), 80 * np.sin(t), closed=closed)
    path = track.with_speed_limits(v_max=45.0, a_y=8.0, a_x=3.0, a_brake=6.0)
    v, k = path.v_x, np.abs(path.curvature)
    assert v.max() <= 45.0
    assert (v**2 * k).max() <= 8.0 * (1 + 1e-9)
    a_x = np.diff(v**2) / (2 * path.spacing)
    assert a_x.max() <= 3.0 * (1 + 1e-9)
    assert a_x.min() >= -6.0 * (1 + 1e-9)
    assert a_x.max() > 1.5  # the limits are used
    assert a_x.min() < -3.0
    assert (v**2 * k).max() > 7.9
    ellipse = np.hypot(v[:-1] ** 2 * k[:-1] / 8.0, np.maximum(a_x, 0) / 3.0)
    assert ellipse.max() <= 1 + 1e-6
    if closed:
        assert v[0] == pytest.approx(v[-1], abs=1e-6)


def test_ahead_at_constant_speed():
    path = double_lane_change(20.0)
    ahead = path.ahead(30.0, 10, 0.05)
    assert len(ahead) == 11
    assert ahead.s == pytest.approx(30.0 + np.arange(11))
    assert ahead.v_x == pytest.approx(20.0)
    assert ahead.r == pytest.approx(20.0 * ahead.curvature)


def test_ahead_starts_at_the_measured_speed_and_keeps_its_distance_to_the_profile():
    path = circle().with_speed(np.linspace(10.0, 20.0, len(circle().s)))
    ahead = path.ahead(100.0, 40, 0.05, v_x=path.at(100.0).v_x[0] - 2.0)
    assert ahead.v_x == pytest.approx(path.at(ahead.s).v_x - 2.0)
    fine = path.ahead(100.0, 4000, 0.0005, v_x=path.at(100.0).v_x[0] - 2.0)
    assert ahead.s == pytest.approx(fine.s[::100], abs=2e-3)


def test_ahead_at_instants_is_the_even_look_at_those():
    path = circle().with_speed(np.linspace(10.0, 20.0, len(circle().s)))
    even = path.ahead(100.0, 12, 0.05, v_x=14.0)
    some = path.ahead(100.0, 0.05 * np.array([0, 1, 2, 4, 5, 9, 12]), v_x=14.0)
    chosen = [0, 1, 2, 4, 5, 9, 12]
    assert np.array_equal(some.s, even.s[chosen])
    assert np.array_equal(some.v_x, even.v_x[chosen])
    assert np.array_equal(path.ahead(100.0, even.t, v_x=14.0).s, even.s)
    odd = path.ahead(100.0, (0.0, 0.05, 0.17, 0.6), v_x=14.0)
    assert odd.s[-1] == pytest.approx(even.s[-1], abs=1e-4)
    assert odd.t == pytest.approx([0.0, 0.05, 0.17, 0.6])


@pytest.mark.parametrize("times", [(0.1, 0.2), (0.0, 0.1, 0.1), (0.0, np.nan), (0.0, np.inf), (0.0,), 5])
def test_ahead_wants_instants_that_rise_from_zero(times):
    with pytest.raises(ParameterError, match="rise from 0 s"):
        circle().ahead(0.0, times, v_x=10.0)


def test_ahead_without_any_speed_is_an_error():
    with pytest.raises(ParameterError, match="with_speed"):
        circle().ahead(0.0, 5, 0.1)
    assert circle().ahead(0.0, 5, 0.1, v_x=10.0).s == pytest.approx(np.arange(6.0))


# ---- files and bad input -------------------------------------------------------------------------------------------


def test_csv_round_trip(tmp_path):
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    table = np.column_stack([50 * np.cos(angle), 50 * np.sin(angle), np.full(60, 3.0), np.full(60, 4.0)])
    file = tmp_path / "ring.csv"
    file.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "\n".join(",".join(map(str, r)) for r in table))
    path = Path.from_csv(file)
    assert path.closed
    assert path.name == "ring"
    assert path.right == pytest.approx(3.0)
    assert path.left == pytest.approx(4.0)
    assert path.inside(45.2 * np.cos(angle), 45.2 * np.sin(angle), 0.0)[0] == np.False_
    assert path.inside(46.2 * np.cos(angle), 46.2 * np.sin(angle), 0.0).all()
    half = tmp_path / "half.csv"
    half.write_text("\n".join(f"{r[0]};{r[1]}" for r in table[:30]))
    assert not Path.from_csv(half).closed
    assert Path.from_csv(half).left is None


@pytest.mark.parametrize(
    ("heading", "units"),
    [
        ("# x_cm,y_cm,w_tr_right_cm,w_tr_left_cm", (100, 100, 100, 100)),
        ("x [cm],y [cm],right,left", (100, 100, 100, 100)),
        ("x_km;y_km;right_m;left_m", (1e-3, 1e-3, 1, 1)),
        ("# made in cm, of the yard\n# x_m,y_m,w_tr_right_m,w_tr_left_m", (1, 1, 1, 1)),
        ("x,y,w_right,w_left", (1, 1, 1, 1)),
    ],
)
def test_headings_say_the_units_of_a_track(tmp_path, heading, units):
    angle = np.linspace(0, 2 * np.pi, 100)[:-1]
    table = np.column_stack([50 * np.cos(angle), 50 * np.sin(angle), 0 * angle + 3, 0 * angle + 4]) * units
    file = tmp_path / "ring.csv"
    file.write_text(heading + "\n" + "\n".join(",".join(f"{v:.9f}" for v in row) for row in table))
    path = Path.from_file(file)
    assert path.closed
    assert path.length == pytest.approx(100 * np.pi, rel=1e-3)
    assert (path.right[0], path.left[0]) == pytest.approx((3, 4))
    assert path.origin is None


def test_columns_of_a_track_go_by_their_headings(tmp_path):
    """In any order, others left out; a width alone is that of the whole track; without headings by place."""
    angle, file = np.linspace(0, 2 * np.pi, 60, endpoint=False), tmp_path / "ring.csv"
    known = {"s_m": 50 * angle, "x_m": 50 * np.cos(angle), "y_m": 50 * np.sin(angle), "psi_rad": angle + np.pi / 2}
    known |= {"v [km/h]": 0 * angle + 90, "right_m": 0 * angle + 3, "left_m": 0 * angle + 4, "width_m": 0 * angle + 8}
    known |= {"East [m]": known["x_m"], "North [m]": known["y_m"]}

    def read(*names, heading=True):
        rows = np.column_stack([known[n] for n in names])
        text = "\n".join(",".join(f"{v:.9f}" for v in row) for row in rows)
        file.write_text(",".join(names) + "\n" + text if heading else text)
        return Path.from_file(file)

    plain = read("x_m", "y_m", "right_m", "left_m", heading=False)
    for names in (
        ("s_m", "x_m", "y_m", "right_m", "left_m", "psi_rad", "v [km/h]"),
        ("left_m", "y_m", "x_m", "right_m"),
        ("North [m]", "East [m]", "v [km/h]", "left_m", "right_m"),
    ):
        path = read(*names)
        np.testing.assert_array_equal(
            (path.X, path.Y, path.right, path.left), (plain.X, plain.Y, plain.right, plain.left)
        )
    for names in (("s_m", "x_m", "y_m", "v [km/h]"), ("x_m", "y_m", "psi_rad", "v [km/h]")):
        path = read(*names)
        np.testing.assert_array_equal((path.X, path.Y), (plain.X, plain.Y))
        assert path.right is path.left is None
    for x, y in (("pos_x_m", "pos_y_m"), ("easting_m", "northing_m"), ("Center_X", "Center_Y"), ("X", "Y")):
        known |= {x: known["x_m"], y: known["y_m"]}
        np.testing.assert_array_equal(read(y, "s_m", x).X, plain.X)
    path = read("x_m", "y_m", "v [km/h]", "width_m")
    assert path.right[0] == path.left[0] == 4
    with pytest.raises(FormatError, match=r"is headed s_m, v \[km/h\]; expected one x and one y"):
        read("s_m", "v [km/h]")
    known["right_m"] = -known["right_m"]
    with pytest.raises(FormatError, match=r"has a width of -3 m; expected distances"):
        read("x_m", "y_m", "right_m", "left_m")


@pytest.mark.parametrize(
    "heading", ["lat,lon,w,w", "# longitude [deg], latitude [deg], right [cm], left [cm]", "lng,lat"]
)
def test_tracks_of_latitude_and_longitude_know_their_origin(tmp_path, heading):
    angle = np.linspace(0, 2 * np.pi, 100)[:-1]
    X, Y = 50 * np.cos(angle), 50 * np.sin(angle)
    lat, lon = degrees_of(X, Y, 52, 13)
    places = [lat, lon] if heading.startswith("lat") else [lon, lat]
    wide = 100 if "cm" in heading else 1
    table = np.column_stack(
        [*places, *([0 * angle + 3 * wide, 0 * angle + 4 * wide] if "w" in heading or wide > 1 else [])]
    )
    file = tmp_path / "ring.csv"
    file.write_text(heading + "\n" + "\n".join(",".join(f"{v:.10f}" for v in row) for row in table))
    path = Path.from_file(file)
    assert path.closed
    assert path.length == pytest.approx(100 * np.pi, rel=1e-3)
    assert path.origin == pytest.approx((np.radians(lat[0]), np.radians(lon[0])), abs=1e-9)
    assert (path.X[0], path.Y[0]) == pytest.approx((0, 0), abs=1e-6)
    assert path.right is None or path.right[0] == pytest.approx(3)
    file.write_text("lat,lon\n" + "\n".join(f"{500 + 10 * k},{k * k}" for k in range(9)))
    with pytest.raises(FormatError, match=r"headed lat, lon and has .*; expected degrees within 90"):
        Path.from_file(file)


def test_a_logger_s_file_is_a_track(tmp_path):
    """GPS before the names, times that are no numbers, decimal commas between semicolons, sides by one letter."""
    angle, file = np.linspace(0, 2 * np.pi, 100)[:-1], tmp_path / "log.csv"
    lat, lon = degrees_of(50 * np.cos(angle), 50 * np.sin(angle), 52, 13)
    for heading, separator in (
        ("Time,GPS Latitude,GPS_Longitude,w_l,w_r", ","),
        ('"Time";"gps_lat";"gps_lon";wl;wr', ";"),
    ):
        rows = [[f"10:00:{k:02d}Z", f"{lat[k]:.9f}", f"{lon[k]:.9f}", "4.5", "3.5"] for k in range(99)]
        text = "\n".join(separator.join(row) for row in rows)
        file.write_text(heading + "\n" + (text.replace(".", ",") if separator == ";" else text))
        path = Path.from_file(file)
        assert path.length == pytest.approx(100 * np.pi, rel=1e-3)
        assert path.origin == pytest.approx((np.radians(lat[0]), np.radians(lon[0])))
        assert (path.right[0], path.left[0]) == (3.5, 4.5)
    file.write_text("time,x,y\n" + "\n".join(f"{k}s,{'nan' if k == 3 else k},{k * k}" for k in range(9)))
    with pytest.raises(NotFiniteError, match=r"line 5 of 'log.csv' is '3s,nan,9'"):
        Path.from_file(file)


@pytest.mark.parametrize("name", ["z_m", "Elevation [m]", "altitude", "bank_deg", "slope"])
def test_a_track_with_slopes_says_that_it_is_flat_here(tmp_path, name):
    file = tmp_path / "hill.csv"
    rows = [(10.0 * k, 0.1 * k * k, 0.0, 4.0, 4.0) for k in range(9)]
    file.write_text(f"x,y,{name},right,left\n" + "\n".join(",".join(map(str, row)) for row in rows))
    flat = Path.from_file(file)  # says nothing: warnings are errors here
    file.write_text(f"x,y,{name},right,left\n" + "\n".join(f"{x},{y},{x / 20},{r},{e}" for x, y, _, r, e in rows))
    with pytest.warns(ModelWarning, match=r"has .* from 0 to 4, which is left out: tracks here are flat"):
        hill = Path.from_file(file)
    np.testing.assert_array_equal((hill.X, hill.right), (flat.X, flat.right))


@pytest.mark.parametrize(("name", "length"), [("Norisring", 2300.0), ("Silverstone", 5891.0), ("Monza", 5793.0)])
def test_race_tracks_have_their_published_length(real_data, name, length):
    path = Path.from_csv(real_data(f"tracks/tum/{name}.csv"), smoothing=0.2)
    assert path.closed
    assert path.length == pytest.approx(length, rel=0.01)
    assert np.abs(path.psi[-1] - path.psi[0]) == pytest.approx(2 * np.pi, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "error", "what"),
    [
        ("1,2\n3,x\n", FormatError, "line 2"),
        ("1,2\n3,4,5\n", FormatError, "3 numbers"),
        ("1,2\n3,4\n", TooShortError, "2 points"),
        ("1,2\n3,nan\n4,5\n5,6\n7,8\n", NotFiniteError, "finite"),
    ],
)
def test_bad_files(tmp_path, text, error, what):
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(error, match=what):
        Path.from_csv(file)


def test_missing_file(tmp_path):
    with pytest.raises(MissingFileError, match=r"no\.csv"):
        Path.from_csv(tmp_path / "no.csv")


@pytest.mark.parametrize(
    "make",
    [
        lambda: Path.from_points([0, 1, 2], [0, 0, 0]),
        lambda: Path.from_points([0, 0, 0, 1], [0, 0, 0, 1]),
        lambda: Path.from_points([0, 1, 2, 3], [0, 0, np.nan, 0]),
        lambda: Path.from_points([0, 1, 2, 3], [0, 0, 0]),
        lambda: Path.from_points([0, 1, 2, 3], [0, 0, 0, 0], smoothing=-1.0),
        lambda: circle().project(np.nan, 0.0),
        lambda: circle().with_speed(-3.0),
        lambda: circle().with_speed(np.ones(3)),
        lambda: circle().with_speed_limits(v_max=10.0, a_y=0.0, a_x=1.0),
        lambda: double_lane_change(20.0, width=0.0),
        lambda: double_lane_change(20.0, blend=20.0),
        lambda: lane_changes(20.0, hold=0.0),
        lambda: Path(s=np.array([0.0, 1, 3]), X=np.zeros(3), Y=np.zeros(3), psi=np.zeros(3), curvature=np.zeros(3)),
        lambda: Path(s=np.arange(3.0), X=np.zeros(3), Y=np.zeros(3), psi=np.zeros(3), curvature=np.zeros(2)),
    ],
)
def test_bad_input_is_a_named_error(make):
    with pytest.raises(SlipangleError):
        make()


def test_track_with_a_comment_in_latin_1(tmp_path):
    file = tmp_path / "t.csv"
    file.write_bytes("# Nürburgring\n0,0\n10,0\n20,1\n30,3\n".encode("latin-1"))
    assert Path.from_csv(file).length == pytest.approx(30.3, abs=0.3)


@pytest.mark.parametrize("far", ["1e9", "1e308", "-1e308", "1e400", "nan", "1_0", "１"])
def test_track_with_a_point_far_away(tmp_path, far):
    file = tmp_path / "t.csv"
    file.write_text(f"0,0\n10,0\n{far},1\n30,3\n40,5\n50,8\n", encoding="utf-8")
    with pytest.raises(SlipangleError):
        Path.from_csv(file)


@pytest.mark.parametrize("scale", [1e9, 1e200, 1e308, 1e-12, 1e-300])
@pytest.mark.parametrize("closed", [True, False])
def test_points_of_any_size_end_in_a_path_or_a_sentence(scale, closed):
    angle = np.linspace(0, 5, 30)
    with pytest.raises(SlipangleError):
        Path.from_points(scale * np.cos(angle), scale * np.sin(angle), closed=closed)


def test_too_long_a_line_names_its_length():
    with pytest.raises(ParameterError, match=r"e\+06 samples 0.25 m apart; expected at most 1000000: check the points"):
        Path.from_points(np.linspace(0, 1e6, 50), np.zeros(50))
    assert Path.from_points(np.linspace(0, 1e6, 50), np.zeros(50), spacing=10.0).length == pytest.approx(1e6)


@pytest.mark.parametrize("setting", ["spacing", "smoothing"])
@pytest.mark.parametrize("value", [np.inf, np.nan, -1.0])
def test_settings_of_a_line_are_checked(setting, value):
    with pytest.raises(ParameterError, match="expected at least 0 m and more than 0 m"):
        Path.from_points(np.linspace(0, 100, 12), np.zeros(12), **{setting: value})


def test_a_track_between_its_edges_is_the_one_they_were_made_of():
    angle = np.linspace(0, 2 * np.pi, 300)[:-1]
    r = 80 + 25 * np.cos(2 * angle)
    made = Path.from_points(r * np.cos(angle), r * np.sin(angle), closed=True, right=5.0, left=4.0)
    left, right = made.boundaries()
    track = Path.from_edges(right[:-1:8], left[:-1:5], closed=True, smoothing=0.02)
    assert track.closed
    assert track.right + track.left == pytest.approx(9.0, abs=0.05)
    assert track.right == pytest.approx(4.5, abs=0.1)
    feet = made.project_all(track.X[::20], track.Y[::20])
    assert np.abs(feet[:, 1]) == pytest.approx(0.5, abs=0.1)
