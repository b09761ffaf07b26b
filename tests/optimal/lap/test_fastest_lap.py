"""The fastest lap against closed forms, mirror images, finer points, and its own multipliers against laps anew."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ModelWarning, ParameterError, SolverError
from slipangle.models.model import FitInfo
from slipangle.models.vehicles.catalogue import BMW_320I, FERRARI_250LM, PASSENGER_TIRE
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.optimal.lap.car import USUAL, LapCar, forces, rates
from slipangle.optimal.lap.course import course
from slipangle.report.lap import lap_page, remarks
from tests.optimal.lap.cars import RACER, circuit, point_like, ring, straight

# The same car with no parameter at an end of its range, so that each can be more and less.
INNER = replace(RACER, even=0.3, drive_rear=0.9, drive_force=8000.0, brake_force=12000.0, rolling_resistance=0.01)


@cache
def lap_of_the_circuit(car=RACER):
    return sa.fastest_lap(car, circuit(), points=80, tolerance=1e-8)


def test_on_a_ring_the_car_circles_at_its_limit_along_the_inner_edge():
    """A mass point circles at v^2 = mu g R, so the smallest ring is the quickest: 2 pi sqrt(R / (mu g))."""
    lap = sa.fastest_lap(point_like(mu=1.2), ring(radius=50.0, width=4.0), points=60)
    R = 50.0 - 4.0 + 0.5
    assert lap.n == pytest.approx(3.5, abs=0.02)
    assert 1.0 <= lap.time / (2 * np.pi * np.sqrt(R / (1.2 * GRAVITY))) < 1.01
    assert np.ptp(lap.v_x) < 0.01


def test_on_a_straight_power_alone_counts():
    """Without drag P t = m (v^2 - v0^2) / 2 and v^3 = v0^3 + 3 P s / m."""
    car = point_like(mu=2.0, power=1e5)
    lap = sa.fastest_lap(car, straight(400.0), points=60, v_start=20.0)
    v = (20.0**3 + 3 * 1e5 * 400.0 / car.mass) ** (1 / 3)
    assert lap.v_x[-1] == pytest.approx(v, rel=1e-3)
    assert lap.time == pytest.approx(car.mass * (v**2 - 20.0**2) / (2 * 1e5), rel=1e-3)


def test_the_mirrored_track_has_the_mirrored_lap():
    lap = lap_of_the_circuit()
    other = sa.fastest_lap(RACER, circuit(mirrored=True), points=80, tolerance=1e-8)
    assert other.time == pytest.approx(lap.time, rel=1e-6)
    for name, sign in (("n", -1), ("delta", -1), ("r", -1), ("v_x", 1), ("F_x", 1)):
        mine = getattr(lap, name)
        assert sign * getattr(other, name) == pytest.approx(mine, abs=2e-3 * np.abs(mine).max())


def test_the_lap_keeps_every_limit():
    lap, car = lap_of_the_circuit(), RACER
    room = 5.0 - 0.5 * car.width
    assert np.abs(lap.n).max() <= room + 1e-6
    assert (lap.F_x * lap.v_x).max() <= car.power * (1 + 1e-5)
    assert np.abs(lap.delta).max() <= car.delta_max
    assert np.abs(lap.rates[:, 0]).max() <= car.delta_rate * (1 + 1e-6)
    assert max(lap.grip_f.max(), lap.grip_r.max()) < 1.02
    assert max(lap.grip_f.max(), lap.grip_r.max()) > 0.97
    assert lap.n.max() - lap.n.min() > 1.5 * room  # it uses the track


def test_the_lap_is_a_drive_of_the_model():
    """Integrated with small steps from its first point, steering and force as in the lap, the car goes the same way."""
    lap = sa.fastest_lap(RACER, circuit(), points=160)
    begin, stop = 41, 121
    x = np.array([lap.X[begin], lap.Y[begin], lap.psi[begin], lap.v_x[begin], lap.v_y[begin], lap.r[begin]])
    times = np.linspace(lap.t[begin], lap.t[stop], 4000)

    def slope(t, x):
        delta, F = np.interp(t, lap.t, lap.delta), np.interp(t, lap.t, lap.F_x)
        c, s, motion = np.cos(x[2]), np.sin(x[2]), rates(x[3], x[4], x[5], delta, F, RACER)
        return np.array([x[3] * c - x[4] * s, x[3] * s + x[4] * c, x[5], motion.v_x, motion.v_y, motion.r])

    h = times[1] - times[0]
    for t in times[:-1]:
        k = slope(t, x)
        x = x + h * slope(t + h / 2, x + h / 2 * k)
    assert np.hypot(x[0] - lap.X[stop], x[1] - lap.Y[stop]) < 0.5  # after half a lap, 270 m
    assert x[3] == pytest.approx(lap.v_x[stop], rel=0.02)


@pytest.mark.parametrize("points", [20, 200])
def test_a_straight_at_one_speed_takes_its_length_over_that(points):
    line = sa.Path.from_points(np.linspace(0.0, 400.0, 50), np.zeros(50), right=5.0, left=5.0)
    lap = sa.fastest_lap(RACER, line, v_start=20.0, v_max=20.0, points=points)
    assert lap.time == pytest.approx(20.0, abs=1e-3)
    assert lap.quasi_steady == pytest.approx(20.0, abs=1e-9)


def test_grip_of_tires_that_share_force_evenly_is_that_of_the_one_with_less_left():
    lap = sa.fastest_lap(replace(RACER, even=1.0), circuit())
    most = max(lap.grip_f.max(), lap.grip_r.max())
    assert 0.97 < most < 1.01


def test_the_lap_beats_its_quasi_steady_start_and_the_middle_of_the_track():
    lap = lap_of_the_circuit()
    middle = sa.fastest_lap(RACER, circuit(), line="given", points=80)
    assert np.abs(middle.n).max() <= 0.05 + 1e-6
    assert middle.sensitivities["width"] == pytest.approx(0.0, abs=1e-9)
    assert lap.time < 0.95 * middle.time
    assert lap.time < 1.1 * lap.quasi_steady


@pytest.mark.slow
def test_four_times_the_points_change_little():
    coarse, fine = (sa.fastest_lap(RACER, circuit(), points=n).time for n in (120, 480))
    assert coarse == pytest.approx(fine, rel=1e-3)


def differences_of(name, lap):
    value = getattr(lap.car, name)
    h = 1e-3 * abs(value) or 1e-3
    costs = [
        sa.fastest_lap(replace(lap.car, **{name: value + d}), lap.track, like=lap, tolerance=1e-8).cost for d in (h, -h)
    ]
    return (costs[0] - costs[1]) / (2 * h)


@pytest.mark.parametrize("name", ["mass", "width"])
def test_sensitivities_are_those_of_laps_anew(name):
    lap = lap_of_the_circuit()
    assert lap.sensitivities[name] == pytest.approx(differences_of(name, lap), rel=1e-3)


def around(radius, turn, straight, width):
    """An open track: a bend by an angle, between two straights of a length, none if zero."""
    a = np.linspace(0.0, turn, 60)
    d = np.linspace(0.0, straight, 40)[1:] if straight else np.zeros(0)
    X = np.concatenate([d[::-1] * 0 + radius, radius * np.cos(a), radius * np.cos(turn) - d * np.sin(turn)])
    Y = np.concatenate([-d[::-1], radius * np.sin(a), radius * np.sin(turn) + d * np.cos(turn)])
    return sa.Path.from_points(X, Y, right=width, left=width, name="around")


@pytest.mark.parametrize(
    ("track", "car", "name"),
    [
        (around(60.0, 4.0, 0.0, 4.0), RACER, "width"),  # begins at an edge
        (around(60.0, 4.0, 0.0, 4.0), replace(RACER, delta_max=0.06), "delta_max"),  # and at the steering's stop
        (around(6.0, np.pi, 60.0, 8.0), RACER, "width"),  # kept off the bend's centre, by no edge
    ],
    ids=["edge", "stop", "centre"],
)
def test_bounds_of_an_open_track_are_worth_what_laps_anew_say(track, car, name):
    lap = sa.fastest_lap(car, track, points=120, tolerance=1e-8)
    assert lap.sensitivities[name] == pytest.approx(differences_of(name, lap), rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in LapCar.felt() if n not in ("mass", "width")])
def test_every_sensitivity_is_that_of_laps_anew(name):
    lap = lap_of_the_circuit(INNER)
    assert lap.sensitivities[name] == pytest.approx(differences_of(name, lap), rel=2e-3, abs=2e-6)


@pytest.mark.parametrize("change", [None, "10", np.nan, True])
def test_a_change_that_is_no_number_is_refused(change):
    with pytest.raises(ParameterError, match=r"the change of 'mass' is .*; expected a number in its own unit"):
        lap_of_the_circuit().worth("mass", change)


def test_only_a_model_says_what_it_leaves_open():
    with pytest.raises(ParameterError, match="the model is 'a'; expected the fitted Model of the lap's car"):
        lap_of_the_circuit().time_std("a")


def test_more_power_is_worth_time_and_more_mass_costs_it():
    lap = lap_of_the_circuit()
    assert lap.worth("power", 1000.0) < 0 < lap.worth("mass", 10.0)
    anew = sa.fastest_lap(replace(RACER, mass=RACER.mass + 10.0), circuit(), like=lap)
    assert lap.worth("mass", 10.0) == pytest.approx(anew.time - lap.time, rel=0.2)


def test_the_driven_line_is_a_path_with_speeds():
    lap = lap_of_the_circuit()
    path = lap.path
    assert path.closed
    assert path.v_x is not None
    assert path.length / np.mean(path.v_x) == pytest.approx(lap.time, rel=0.02)


@pytest.mark.parametrize("points", [120, 300])
@pytest.mark.parametrize("closed", [True, False])
def test_the_line_of_the_lap_bends_as_the_lap_does(points, closed):
    whole = circuit()
    part = sa.Path.from_points(whole.X[:800:4], whole.Y[:800:4], right=5.0, left=5.0)
    lap = sa.fastest_lap(RACER, whole if closed else part, points=points)
    line = lap.path
    slip, speed = np.arctan2(lap.v_y, lap.v_x), np.hypot(lap.v_x, lap.v_y)
    across = lap.a_y * np.cos(slip) - lap.a_x * np.sin(slip)  # what the drive itself has, by its forces
    ends = slice(1, None if closed else -4, 2)  # where nothing follows, the drive ends with a jerk
    feet = line.project_all(lap.X[ends], lap.Y[ends])
    assert np.abs(feet[:, 1]).max() < 0.06
    last = len(line.s) if closed else -round(12 / line.spacing)
    assert np.abs(line.v_x**2 * line.curvature)[:last].max() < 1.02 * np.abs(across).max()
    bend = across[ends] / speed[ends] ** 2
    assert line.at(feet[:, 0]).curvature == pytest.approx(bend, abs=0.08 * np.abs(bend).max())
    heading = np.unwrap(line.at(feet[:, 0]).psi - (lap.psi + slip)[ends])
    assert heading - 2 * np.pi * np.round(heading / 2 / np.pi) == pytest.approx(0.0, abs=0.01)


def test_where_the_car_does_not_fit_is_named():
    with pytest.raises(ParameterError, match=r"1\.6 m wide .* the car needs 1\.9 m"):
        sa.fastest_lap(RACER, circuit(width=0.8), points=60)


def oval(at=None, right=5.0):
    """A closed track whose points are 3 m apart, of which one may be a gate."""
    angle = np.linspace(0.0, 2 * np.pi, 133)[:-1]
    gate = np.where(np.arange(132) == at, right, 5.0)
    return sa.Path.from_points(80 * np.cos(angle), 45 * np.sin(angle), closed=True, right=gate, left=5.0)


@pytest.mark.parametrize("at", [64, 65])
def test_a_gate_between_two_points_is_driven_through(at):
    wide, gate = (sa.fastest_lap(RACER, track, points=60) for track in (oval(), oval(at, right=1.5)))
    post = gate.track.right.argmin()
    X, Y, psi = gate.track.X[post], gate.track.Y[post], gate.track.psi[post]
    line = gate.path
    near = np.hypot(line.X - X, line.Y - Y).argmin()
    across = (line.Y[near] - Y) * np.cos(psi) - (line.X[near] - X) * np.sin(psi)
    assert across > RACER.width / 2 - 1.5 - 0.1
    assert gate.time > wide.time


def test_a_gate_between_two_points_that_the_car_does_not_fit_through_is_named():
    with pytest.raises(ParameterError, match=r"m wide 19. m after its start, the car needs 1\.9 m"):
        sa.fastest_lap(RACER, oval(65, right=-4.0), points=60)


@pytest.mark.parametrize("inside", [1.5, 9.0])
def test_a_width_that_leaps_holds_on_both_sides_of_the_leap(inside):
    """From 4 m to less or to more at once: 4 m stay 4 m, and no line cuts the corner that the wider edge has."""
    kidney = circuit()
    wide = np.where((kidney.s > 200) & (kidney.s < 300), inside, 4.0)
    track = replace(kidney, right=wide, left=wide)
    along = course(track, np.linspace(0.0, track.length, 61), room=1.0, tolerance=None)
    near = np.interp(along.s, track.s, wide)
    assert (along.high[near == near.min()] == near.min() - 1.0).all()
    assert (along.high[np.abs(along.s - 250) < 30] == np.minimum(inside - 1.0, along.high.max())).all()
    between = np.interp(track.s, along.s, along.high, period=track.length)
    assert (between - (wide - 1.0)).max() <= 0.03 * 2 * wide.mean()
    lap = sa.fastest_lap(RACER, track, points=120)
    s = np.linspace(0.0, track.length, 4000)
    n = np.interp(s, lap.s, lap.n, period=track.length)
    assert (np.abs(n) + 0.5 * RACER.width - track.at(s).left).max() < 0.03 * 8.0


@pytest.mark.parametrize("closed", [True, False])
def test_edges_that_change_slowly_are_those_at_the_points(closed):
    s = np.arange(0.0, 400.0, 5.0)
    angle = 2 * np.pi * s / 400.0
    X, Y = (60 * np.cos(angle), 60 * np.sin(angle)) if closed else (s, 0 * s)
    track = sa.Path.from_points(X, Y, closed=closed, right=5 - np.sin(3 * angle), left=4 + np.cos(2 * angle))
    along = course(track, np.linspace(0.0, track.length, 60), room=0.9, tolerance=None)
    assert (along.high == track.at(along.s).left - 0.9).all()
    assert (along.low == 0.9 - track.at(along.s).right).all()


def test_a_track_without_edges_is_named():
    track = circuit()
    bare = sa.Path.from_points(track.X[::40], track.Y[::40], closed=True)
    with pytest.raises(ParameterError, match="no edges"):
        sa.fastest_lap(RACER, bare, points=60)
    assert sa.fastest_lap(RACER, bare, points=60, line="given").status.solved


def test_a_lap_that_was_not_found_is_no_lap():
    with pytest.raises(SolverError, match="iteration limit"):
        sa.fastest_lap(RACER, circuit(), points=60, iterations=2)


@pytest.mark.parametrize(("delta_max", "named"), [(0.04, True), (0.5, False)])
def test_a_steering_that_does_not_turn_enough_is_named(delta_max, named):
    """Round the inside of a ring of 20 m, 2.7 m between the axles: atan(2.7 / 17) = 0.16 rad, by geometry alone."""
    small, car = ring(radius=20.0, width=4.0), replace(RACER, delta_max=delta_max)
    with pytest.raises(SolverError) as caught:
        sa.fastest_lap(car, small, points=40, iterations=30 if named else 2)
    said = re.search(r"turns the wheels by 0.04 rad at most, .* takes (\S+) rad on the line", str(caught.value))
    assert bool(said) == named
    if said:
        assert np.arctan(2.7 / 23.05) - 2e-3 <= float(said[1]) <= np.arctan(2.7 / 16.95) + 2e-3


def test_a_start_too_fast_to_brake_from_is_named():
    s = np.arange(0.0, 120.0, 5.0)
    bend = sa.Path.from_points(s, 15 * np.sin(s / 20.0), right=3.0, left=3.0)
    with pytest.raises(SolverError, match=r"v_start is 80 m/s, .* expected a lower one"):
        sa.fastest_lap(RACER, bend, points=60, v_start=80.0)


def test_settings_out_of_range_are_named():
    for wrong in ({"points": 5}, {"smoothness": 0.0}, {"v_max": -1.0}, {"margin": -1.0}, {"line": "best"}):
        with pytest.raises(ParameterError):
            sa.fastest_lap(RACER, circuit(), **wrong)
    for wrong in ({"points": 60.5}, {"points": "60"}, {"iterations": 0}, {"tolerance": 0.0}, {"tolerance": 1.0}):
        with pytest.raises(ParameterError, match="expected"):
            sa.fastest_lap(RACER, circuit(), **wrong)  # pyright: ignore
    for name, wrong in (("margin", "a"), ("v_max", None), ("margin", np.ones(2)), ("smoothness", True)):
        with pytest.raises(ParameterError, match=rf"^{name} is .*; expected [\d.]+ to \d+$"):
            sa.fastest_lap(RACER, circuit(), **{name: wrong})
    with pytest.raises(ParameterError, match="allowed is 3; expected a function of arc lengths"):
        sa.fastest_lap(RACER, circuit(), allowed=3)  # pyright: ignore
    with pytest.raises(ParameterError, match="the lap to be like is 3; expected a Lap of 'circuit'"):
        sa.fastest_lap(RACER, circuit(), like=3)  # pyright: ignore
    with pytest.raises(ParameterError, match="closed"):
        sa.fastest_lap(RACER, circuit(), v_start=10.0)
    with pytest.raises(ParameterError, match="expected a Path"):
        sa.fastest_lap(RACER, "track.csv")  # pyright: ignore


def test_cars_without_limits_or_power_are_named():
    bicycle = sa.Bicycle(params=FERRARI_250LM, dt=0.01)
    with pytest.raises(ParameterError, match="how much its tires can hold"):
        sa.lap_car(bicycle)
    p = sa.NonlinearBicycleParams(mass=982.0, inertia_z=1200.0, wheelbase=2.4, l_f=1.39, C_f=8e4, C_r=1e5)
    with pytest.raises(ParameterError, match="power"):
        sa.lap_car(sa.NonlinearBicycle(params=p, dt=0.01))
    assert sa.lap_car(sa.NonlinearBicycle(params=p, dt=0.01), power=2e5).C_f == 8e4


@pytest.mark.parametrize("unit", [100.0, 1000.0])
def test_widths_in_another_unit_are_named(unit):
    """A lap between edges that lie beyond each other would be an optimum of nothing."""
    track = circuit()
    wide = replace(track, right=track.right * unit, left=track.left * unit)
    with pytest.raises(ParameterError, match=r"'circuit' is \d+ m wide and .* m long; expected widths in m"):
        sa.fastest_lap(RACER, wide)


@pytest.mark.parametrize("right", [-5.0, -1.0])
def test_widths_to_the_right_that_are_negative_are_named(right):
    """As offsets to the left have them: 5 m to the left and -1 m to the right would be a lap four metres wide."""
    track = circuit()
    signed = replace(track, right=0 * track.right + right, left=0 * track.left + 5.0)
    with pytest.raises(ParameterError, match=rf"'circuit' has its right edge at {right:g} m; .* give right=-right"):
        sa.fastest_lap(RACER, signed)


@pytest.mark.parametrize("power", [1.0, 90.0])
def test_a_car_that_stands_still_is_named(power):
    """90 kW given as 90: road and air take 0.015 * 11.8 kN and more, which is 90 W at half a metre a second."""
    car = replace(RACER, power=power, rolling_resistance=0.015)
    with pytest.raises(ParameterError, match=rf"power is {power:g} W .* take 1\d\d N: it stands still; .* in W"):
        sa.fastest_lap(car, circuit(), points=60)


@pytest.mark.parametrize("size", [0.1, 1.0, 2.0])
def test_what_nobody_says_of_a_car_goes_with_its_size(size):
    """Froude: times go as the root of the length. A lorry is no wider than other cars."""
    p = sa.SaturatingBicycleParams(
        **dict(mass=1200 * size**3, inertia_z=1500 * size**5, wheelbase=USUAL * size, l_f=1.3 * size),
        **dict(C_f=1.1e5 * size**3, C_r=1.3e5 * size**3, mu_f=1.0, mu_r=1.0),
    )
    with pytest.warns(ModelWarning, match=r"no drag \(drag=0 kg/m\), driven rear wheels .* across .* and along"):
        car = sa.lap_car(sa.SaturatingBicycle(params=p, dt=0.01), power=9e4 * size**3.5)
    assert car.width == pytest.approx(1.8 * min(size, 1.0))
    assert (car.delta_rate, car.force_rate) == pytest.approx((size**-0.5, 8.0 * size**-0.5))
    assert sa.lap_car(car, width=0.5).width == 0.5
    assert sa.lap_car(car).delta_rate == car.delta_rate


def test_what_a_fit_leaves_open_is_the_spread_of_laps_anew():
    """Cars drawn from the fit's covariance, each with a lap of its own; what is known otherwise does not count."""
    names, std = ("mu_f", "mu_r", "C_f"), np.array([0.03, 0.03, 4e3])
    covariance = np.outer(std, std) * np.array([[1, 0.5, 0.2], [0.5, 1, 0], [0.2, 0, 1]])
    p = sa.NonlinearBicycleParams(
        mass=1200, inertia_z=1500, wheelbase=2.7, l_f=1.4, C_f=8e4, C_r=1.1e5, mu_f=1.0, mu_r=1.1
    )
    values = np.array([getattr(p, n) for n in names])
    info = FitInfo(names=names, values=values, covariance=covariance, noise_std=np.array([0.01]), n_samples=100)
    model = replace(sa.NonlinearBicycle(params=p, dt=0.01), fit_info=info)
    lap = sa.fastest_lap(model_car := sa.lap_car(model, power=1.5e5), circuit(), points=120)
    rng = np.random.default_rng(0)
    drawn = [
        dict(zip(names, rng.multivariate_normal(values, covariance, method="cholesky"), strict=True)) for _ in range(30)
    ]
    spread = np.std([sa.fastest_lap(replace(model_car, **d), circuit(), like=lap).time for d in drawn], ddof=1)
    assert lap.time_std(model) == pytest.approx(spread, rel=0.35)
    assert lap.time_std(model) > 0.05
    assert 0 < lap.time_std(model, known=("mu_f", "mu_r")) < 0.1 * lap.time_std(model)
    assert np.isnan(lap.time_std(replace(model, fit_info=None)))
    loose = replace(info, covariance=np.diag([np.inf, 1e-3, 1e6]))
    assert lap.time_std(replace(model, fit_info=loose)) == np.inf


def test_the_lap_of_a_saturating_bicycle_has_its_downforce():
    axles = dict(C_f=8e4, C_r=1e5, mu_f=1.2, mu_r=1.3, downforce_f=0.9, downforce_r=1.4)
    p = sa.SaturatingBicycleParams(mass=982.0, inertia_z=1200.0, wheelbase=2.4, l_f=1.39, **axles)
    plain = {"drag": 0.0, "drive_rear": 1.0, "transfer_x": 0.0, "transfer_f": 0.0}  # said: nothing to warn of
    car, v = sa.lap_car(sa.SaturatingBicycle(params=p, dt=0.01), power=2e5, **plain), 60.0
    front, rear = 982.0 * GRAVITY * 1.01 / 2.4 + 0.9 * v**2, 982.0 * GRAVITY * 1.39 / 2.4 + 1.4 * v**2
    acting = forces(0.02, 0.5, -car.resistance(v), 0.0, v, car)
    assert acting.rear.peak == pytest.approx(1.3 * rear, rel=1e-3)
    slope = 8e4 * front / (982.0 * GRAVITY * 1.01 / 2.4)  # in proportion to the load, whatever the peak
    force = 1.2 * front * np.sin(1.4 * np.arctan(slope * 0.02 / (1.4 * 1.2 * front)))
    assert acting.front.F_y == pytest.approx(force, rel=0.02)


def test_the_axles_of_a_dual_track_are_those_of_its_tires():
    car = sa.lap_car(sa.DualTrack(params=BMW_320I, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001))
    load = 0.25 * BMW_320I.mass * GRAVITY
    for alpha in np.radians([1.0, 3.0, 6.0, 10.0]):
        own = 2 * PASSENGER_TIRE.forces(0.0, alpha, load).F_y + 2 * PASSENGER_TIRE.forces(0.0, alpha, load).F_y
        both = forces(alpha, alpha, 0.0, 0.0, 0.0, car)
        assert both.front.F_y + both.rear.F_y == pytest.approx(own, rel=0.06)
    assert car.power == pytest.approx(150.0 * 600.0, rel=1e-6)  # at its highest speed
    assert car.brake_rear == pytest.approx(1 - BMW_320I.brakes.bias)
    assert car.transfer_x == pytest.approx(BMW_320I.height / BMW_320I.wheelbase)


def test_load_transfer_of_a_dual_track_is_its_height_over_its_track():
    """Moments about the ground: both axles' transfer times their track make the height."""
    car = sa.lap_car(sa.DualTrack(params=BMW_320I, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001))
    p = BMW_320I
    assert car.transfer_f * p.track_f + car.transfer_r * p.track_r == pytest.approx(p.height, rel=1e-6)


def test_a_lap_shows_itself():
    lap = lap_of_the_circuit()
    assert "circuit, " in repr(lap)
    html = lap._repr_html_()
    assert "lap time" in html
    assert "1 % more mass" in html
    assert len(lap.plot().data) >= 4  # the line, its dots, both edges
    assert len(lap.plot("v_x", "delta").data) == 2
    with pytest.raises(ParameterError, match="no channel of a lap 'speed'"):
        lap.plot("speed")


def test_a_lap_knows_how_fast_its_track_is_entered():
    slow, free = (sa.fastest_lap(RACER, straight(), points=60, v_start=v) for v in (3.0, None))
    assert slow.v_start == pytest.approx(3.0)
    assert free.v_start == pytest.approx(120.0, rel=1e-3)
    assert "entered at 11 km/h" in repr(slow)
    words = re.sub(r"<[^>]+>", " ", lap_page(slow, "", "").to_html())
    assert re.search(r"lowest speed\s+10\.8\d*\s+km/h", words)  # which it was entered at
    closed = lap_of_the_circuit()
    assert min(closed.v_x[[0, -1]]) - 0.1 <= closed.v_start <= max(closed.v_x[[0, -1]]) + 0.1


@pytest.mark.filterwarnings("ignore:the line of 'slalom' turns to and fro")
def test_a_slalom_says_that_smoothness_makes_it_slow():
    X = np.linspace(0.0, 100.0, 200)
    track = sa.Path.from_points(X, 1.5 * np.sin(2 * np.pi * X / 26), right=1.5, left=1.5, name="slalom")
    calm, quick = (sa.fastest_lap(replace(RACER, width=1.4), track, smoothness=w) for w in (1.0, 0.03))
    assert calm.calm == pytest.approx((calm.cost - calm.time) / calm.time)
    assert quick.time < 0.97 * calm.time
    assert re.search(r"entered at \d+ km/h, calm: it can be faster with less smoothness", repr(calm))
    assert "The track is open, and entered at" in remarks(calm)
    assert "entered" not in remarks(lap_of_the_circuit()) + repr(lap_of_the_circuit())
    assert "smoothness = 0.1, the lap is faster" in remarks(calm)
    for lap in (quick, lap_of_the_circuit()):
        assert "smoothness" not in repr(lap) + remarks(lap)


def test_what_is_allowed_at_a_place_holds_there_and_costs_time():
    free = sa.fastest_lap(RACER, circuit(), points=80)
    slow = np.where(np.arange(80) == int(np.argmin(free.v_x)), 0.95 * free.v_x, np.inf)
    weak = np.where(free.s < 150.0, 1500.0, np.inf)
    bound = sa.fastest_lap(RACER, circuit(), like=free, allowed=lambda s: (weak, slow))
    assert np.all(bound.v_x <= slow + 1e-6)
    assert np.all(bound.F_x <= weak + 1e-3)
    assert free.F_x[free.s < 150.0].max() > 2000.0
    assert bound.time > free.time


def test_what_cannot_be_allowed_is_refused():
    with pytest.raises(ParameterError, match="forces above zero"):
        sa.fastest_lap(RACER, circuit(), points=80, allowed=lambda s: (0.0 * s, 30.0 + s))
    with pytest.raises(ParameterError, match="the largest forces and the largest speeds"):
        sa.fastest_lap(RACER, circuit(), points=80, allowed=lambda s: s)  # pyright: ignore
