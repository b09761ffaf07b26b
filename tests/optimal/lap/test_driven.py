"""Laps of a log against the fastest one: logs that are made of a lap, driven again with a known loss."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import MissingColumnError, ParameterError, TooShortError
from slipangle.report.lap import beaten, lap_page, lost_most, sector_table
from tests.data.earth import degrees_of
from tests.optimal.lap.cars import RACER, circuit, straight

DT = 0.02


@cache
def fastest():
    return sa.fastest_lap(RACER, circuit(), points=80)


def log_of(lap, lost=0.0, between=(0.0, 1.0), laps=2.7, names=("X", "Y")):
    """A log of some laps from half a lap before the start line on; ``lost`` seconds go evenly between two places."""
    length, s = lap.track.length, np.append(0.0, lap.s)
    t = np.append(0.0, lap.t) + lost * np.clip((s - between[0]) / (between[1] - between[0]), 0.0, 1.0)
    n = np.interp(s, lap.s, lap.n, period=length)
    way = np.arange(0.5, 0.5 + laps, 1e-4) * length
    at = t[-1] * (way // length) + np.interp(way % length, s, t)
    times = np.arange(0.0, at[-1] - at[0], DT)
    driven = np.interp(times + at[0], at, way)
    place = lap.track.at(driven)
    off = np.interp(driven, s, n, period=length)
    X, Y = place.X - off * np.sin(place.psi), place.Y + off * np.cos(place.psi)
    channels = [sa.Channel(name, unit) for name, unit in zip(names, ("m", "m"), strict=True)]
    return sa.Dataset(values=np.column_stack([X, Y]), channels=channels, dt=DT, start_times=(7.0,))


def test_the_laps_of_a_log_are_cut_at_the_start_line():
    lap = fastest()
    first, second = sa.driven_laps(log_of(lap), lap.track)
    assert (first.number, second.number) == (1, 2)
    assert first.time == pytest.approx(lap.time, abs=5e-3)
    assert second.time == pytest.approx(lap.time, abs=5e-3)
    assert second.begin - first.begin == pytest.approx(lap.time, abs=5e-3)
    assert first.begin > 7.0
    assert first.n == pytest.approx(np.interp(first.s, lap.s, lap.n, period=lap.track.length), abs=0.02)
    gap = np.abs(first.v_x - np.interp(first.s, lap.s, lap.v_x, period=lap.track.length))
    assert np.median(gap) < 0.5  # m/s, from the places alone
    assert "lap 1 of circuit" in repr(first)
    assert len(first.plot().data) == 2


@pytest.mark.parametrize("size", [1.0, 0.1])
@pytest.mark.parametrize(("rate", "noise"), [(10.0, 0.5), (25.0, 0.5), (100.0, 0.5), (25.0, 2.0), (25.0, 0.0)])
def test_the_speed_of_places_with_noise_is_that_of_the_car(rate, noise, size):
    """Round a circle of 60 m at 15 m/s and 5 more and less, by a receiver off by white noise; a small car alike.

    Plain differences are off by 3.5, 8.8, 35 and 35 m/s, as noise times the rate over the root of two is.
    """
    root = size**0.5
    t = np.arange(0.0, 60.0, 1.0 / rate)
    way = 15.0 * t + 5.0 / 0.8 * (1.0 - np.cos(0.8 * t))
    places = 60.0 * np.column_stack([np.cos(way / 60.0), np.sin(way / 60.0)])
    places = size * (places + noise * np.random.default_rng(3).standard_normal(places.shape))
    channels = [sa.Channel("X", "m"), sa.Channel("Y", "m")]
    log = sa.Dataset(values=places, channels=channels, dt=root / rate)
    a = np.linspace(0, 2 * np.pi, 200)[:-1]
    X, Y = (60.0 * size * c for c in (np.cos(a), np.sin(a)))
    round_it = sa.Path.from_points(X, Y, closed=True, spacing=0.5 * size)
    driven = sa.driven_laps(log, round_it)[0]
    true = 15.0 + 5.0 * np.sin(0.8 * (driven.begin + driven.t) / root)
    off = np.sqrt(np.mean((driven.v_x / root - true) ** 2))
    assert off < (1.3 if noise else 0.1)
    assert len(driven.s) == 401


def test_the_same_lap_loses_nothing_anywhere():
    lap = fastest()
    delta = sa.lap_delta(lap, sa.driven_laps(log_of(lap), lap.track)[0])
    assert delta.delta == pytest.approx(0.0, abs=0.03)
    assert all(abs(sector.lost) < 0.05 for sector in delta.sectors)


def test_a_lap_that_is_faster_than_the_fastest_is_no_loss():
    lap = fastest()
    same, faster = (
        sa.lap_delta(lap, sa.driven_laps(replace(log_of(lap), dt=pace * DT), lap.track)[0]) for pace in (1.0, 0.93)
    )
    assert not beaten(same)
    said = sector_table(faster).caption
    assert f"is {0.07 * lap.time:.2f} s faster than the fastest lap of this car" in said
    assert "You lose nothing in any." in said
    assert lost_most(faster, 3) == []
    verdicts = [page.sections[0].blocks[0] for page in (lap_page(lap, "", "", delta) for delta in (same, faster))]
    assert [verdict.tone for verdict in verdicts] == ["good", "poor"]
    assert "its grip or its power is set too low" in verdicts[1].sentence


def test_what_is_lost_is_lost_in_its_sector():
    lap = fastest()
    whole = sa.lap_delta(lap, sa.driven_laps(log_of(lap), lap.track)[0])
    sector = whole.sectors[1]
    assert len(whole.sectors) >= 3
    between = (sector.begin + 5.0, sector.end - 5.0)
    delta = sa.lap_delta(lap, sa.driven_laps(log_of(lap, 0.31, between), lap.track)[1])
    assert delta.delta[-1] == pytest.approx(0.31, abs=0.02)
    assert [round(one.lost, 1) for one in delta.sectors] == [0.3 if k == 1 else 0.0 for k in range(len(delta.sectors))]
    assert sum(one.lost for one in delta.sectors) == pytest.approx(delta.delta[-1], abs=1e-9)
    assert delta.driven.time - lap.time == pytest.approx(delta.delta[-1], abs=1e-9)
    assert f"most at {delta.sectors[1].corner:.0f} m" in repr(delta)
    assert "You lose 0.31 s" in delta._repr_html_() or "You lose 0.3" in delta._repr_html_()
    assert len(delta.plot().data) >= 3


def test_a_log_of_latitude_and_longitude_is_one_of_places():
    lap = fastest()
    plain = log_of(lap)
    X, Y = plain["X"] - plain["X"][0], plain["Y"] - plain["Y"][0]
    lat, lon = (np.radians(v) for v in degrees_of(X, Y, np.degrees(0.7), np.degrees(0.2)))
    channels = [sa.Channel("latitude", "rad"), sa.Channel("longitude", "rad")]
    values = np.column_stack([lat, lon])
    data = sa.Dataset(values=values, channels=channels, dt=DT)
    edge = lap.track
    moved = sa.Path.from_points(edge.X - plain["X"][0], edge.Y - plain["Y"][0], closed=True)
    assert sa.driven_laps(data, moved)[0].time == pytest.approx(lap.time, abs=0.02)


def of_angles(log, lat=0.7, lon=0.2):
    """The same log by latitude and longitude, the frame's zero at these."""
    values = np.radians(np.column_stack(degrees_of(log["X"], log["Y"], np.degrees(lat), np.degrees(lon))))
    channels = [sa.Channel("latitude", "rad"), sa.Channel("longitude", "rad")]
    return sa.Dataset(values=values, channels=channels, dt=DT, name="gps")


def test_latitude_and_longitude_count_from_the_track_s_origin():
    lap = fastest()
    data = of_angles(log_of(lap))
    plain = sa.driven_laps(log_of(lap), lap.track)[0]
    for found in (
        sa.driven_laps(data, lap.track, origin=(0.7, 0.2))[0],
        sa.driven_laps(data, replace(lap.track, origin=(0.7, 0.2)))[0],
    ):
        assert found.time == pytest.approx(plain.time, abs=1e-3)
        assert found.n == pytest.approx(plain.n, abs=0.05)


@pytest.mark.parametrize(
    ("names", "unit"), [(("lat", "lon"), "rad"), (("lat", "lng"), "-"), (("Latitude", "Longitude"), "-")]
)
def test_a_log_may_call_them_as_a_track_file_does(names, unit):
    lap = fastest()
    data = of_angles(log_of(lap))
    values = data.values if unit == "rad" else np.degrees(data.values)
    other = replace(data, values=values, channels=tuple(sa.Channel(name, unit) for name in names))
    found, known = (sa.driven_laps(log, lap.track, origin=(0.7, 0.2))[0] for log in (other, data))
    assert found.n == pytest.approx(known.n, abs=1e-6)
    misled = replace(data, channels=(sa.Channel("lateral"), sa.Channel("lon")))
    with pytest.raises(MissingColumnError, match="no latitude and longitude"):
        sa.driven_laps(misled, lap.track, origin=(0.7, 0.2))


def test_a_track_that_does_not_say_where_it_lies_is_asked_for_its_origin():
    lap = fastest()
    middle = (lap.track.X[0], lap.track.Y[0])
    aside = sa.Path.from_points(
        lap.track.X[::20] - middle[0] + 15.0, lap.track.Y[::20] - middle[1] + 15.0, closed=True, right=5.0, left=5.0
    )
    with pytest.raises(ParameterError, match=r"does not say where its X and Y are zero.*give origin="):
        sa.driven_laps(of_angles(log_of(lap)), aside)
    with pytest.raises(MissingColumnError, match="no latitude and longitude to count from"):
        sa.driven_laps(log_of(lap), lap.track, origin=(0.7, 0.2))
    with pytest.raises(ParameterError, match="expected latitude and longitude"):
        sa.driven_laps(of_angles(log_of(lap)), lap.track, origin=(0.7, np.nan))


@pytest.mark.parametrize("edges", [None, 5.0])
def test_laps_beside_the_track_as_a_whole_are_named(edges):
    lap = fastest()
    track = sa.Path.from_points(lap.track.X[::20], lap.track.Y[::20], closed=True, right=edges, left=edges)
    log = of_angles(log_of(lap))
    there = (0.7 - 19.0 / 6.4e6, 0.2)
    with pytest.raises(ParameterError, match=r"lie \d+\.\d m beside the line .* in the median, beyond its edges"):
        sa.driven_laps(log, track, origin=there)


def test_logs_without_a_lap_are_named():
    lap = fastest()
    with pytest.raises(TooShortError, match="no complete lap"):
        sa.driven_laps(log_of(lap, laps=0.9), lap.track)
    with pytest.raises(MissingColumnError, match="place of the car"):
        sa.driven_laps(log_of(lap, names=("east", "north")), lap.track)
    far = log_of(lap)
    far = sa.Dataset(values=far.values + 1000.0, channels=far.channels, dt=DT)
    with pytest.raises(ParameterError, match="comes no nearer"):
        sa.driven_laps(far, lap.track)
    with pytest.raises(ParameterError, match="is open"):
        sa.driven_laps(log_of(lap), straight())
    other = sa.Path.from_points(1.1 * lap.track.X[::40], 1.1 * lap.track.Y[::40], closed=True, name="other")
    driven = sa.driven_laps(log_of(lap), other)[0]
    with pytest.raises(ParameterError, match=r"the fastest lap is one of 'circuit', .* expected one of 'other'"):
        sa.lap_delta(lap, driven)
    with pytest.raises(ParameterError, match="the fastest lap is <DrivenLap"):
        sa.lap_delta(driven, lap)  # pyright: ignore


def test_why_a_log_has_no_lap_is_said():
    lap = fastest()
    log = log_of(lap, laps=2.5)
    back = sa.Dataset(values=log.values[::-1], channels=log.channels, dt=DT)
    with pytest.raises(TooShortError, match="against the direction of the track"):
        sa.driven_laps(back, lap.track)
    wide = sa.Dataset(values=log.values * [2.0, 1.0], channels=log.channels, dt=DT)
    with pytest.raises(TooShortError, match=r"% of its places are more than 30 m from the line"):
        sa.driven_laps(wide, lap.track)
    with pytest.raises(TooShortError, match="take a longer record"):
        sa.driven_laps(log_of(lap, laps=0.9), lap.track)


@pytest.mark.slow
def test_a_racing_car_s_log_on_the_track_of_its_edges(real_data):
    """A full-size car with its own edges: one lap, which runs between them."""
    inner, outer = (
        np.loadtxt(real_data(f"iac/putnam_{side}_bound.csv"), delimiter=",")[::-1, :2] for side in ("inner", "outer")
    )
    table = np.genfromtxt(real_data("iac/Putnam_park2023_run4_2.csv"), delimiter=",")
    turning = np.sum(inner[:-1, 0] * inner[1:, 1] - inner[1:, 0] * inner[:-1, 1])
    if turning > 0:
        inner, outer = inner[::-1], outer[::-1]
    track = sa.Path.from_edges(inner, outer, closed=True, name="Putnam Park")
    channels = [sa.Channel("X", "m"), sa.Channel("Y", "m"), sa.Channel("v_x", "m/s")]
    (driven,) = sa.driven_laps(sa.Dataset(values=table[:, 1:4], channels=channels, dt=0.04), track)
    assert driven.time == pytest.approx(160.6, abs=0.5)
    edges = track.at(driven.s)
    assert (driven.n < edges.left).all()
    assert (driven.n > -edges.right).all()


def test_laps_are_cut_of_a_log_on_a_path():
    with pytest.raises(ParameterError, match=r"driven_laps\(\) is given a str; expected a Dataset"):
        sa.driven_laps("a", circuit())
    with pytest.raises(ParameterError, match="the track is 'a'; expected a Path"):
        sa.driven_laps(log_of(fastest()), "a")
