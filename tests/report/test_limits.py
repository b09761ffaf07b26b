"""g-g diagrams and tire forces against Newton, Euler and the friction of the axles."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ParameterError
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.report.limits import accelerations
from tests.models.analysis.test_linearize import BICYCLE, CAR

PARAMS = sa.SaturatingBicycleParams(**CAR, mu_f=0.9, mu_r=0.8)
CAR_AT_LIMIT = sa.SaturatingBicycle(params=PARAMS, dt=0.01, outputs=("r", "v_y", "a_y"))
UNITS = {"delta": "rad", "v_x": "m/s", "r": "rad/s", "v_y": "m/s", "a_y": "m/s2"}


def driven():
    t = 0.01 * np.arange(1500)
    inputs = {"delta": 0.03 * np.sin(1.5 * t), "v_x": np.full(1500, 20.0)}
    empty = dict.fromkeys(("r", "v_y", "a_y"), np.zeros(1500))
    data = sa.Dataset.from_arrays(inputs, empty, 0.01, units=UNITS)
    y = CAR_AT_LIMIT.simulate(data).y
    for i, name in enumerate(("r", "v_y", "a_y")):
        data = data.with_channel(name, y[:, i], UNITS[name])
    return data


def only(data, *names):
    """The same with fewer channels."""
    units = {n: UNITS[n] for n in names}
    return sa.Dataset.from_arrays({}, {n: data[n] for n in names}, data.dt, units=units)


def test_the_limits_are_the_friction_of_the_axles():
    plain = {"drag": 0.0, "drive_rear": 1.0, "transfer_x": 0.0, "transfer_f": 0.0}
    car = sa.lap_car(CAR_AT_LIMIT, power=1e7, brake_rear=0.4, **plain)
    found = sa.gg_diagram(car=car, v_x=[20.0])
    edge = found.limits[0]
    assert edge[0] == pytest.approx(edge[-1])
    assert edge[:, 0].max() == pytest.approx(0.8 * GRAVITY, rel=0.01)  # the rear axle holds less
    assert edge[:, 0].min() == -edge[:, 0].max()
    assert edge[0, 1] == pytest.approx(0.98 * 0.8 * GRAVITY * CAR["l_f"] / CAR["wheelbase"], rel=0.03)
    front = 0.98 * 0.9 * GRAVITY * (CAR["wheelbase"] - CAR["l_f"]) / CAR["wheelbase"] / 0.6
    assert -edge[:, 1].min() == pytest.approx(front, rel=0.03)


def test_a_logs_accelerations_are_measured_or_follow_from_its_motion():
    data = driven()
    a_x, a_y = accelerations(only(data, "v_x", "r", "v_y"))
    assert a_y[5:-5] == pytest.approx(data["a_y"][5:-5], abs=0.02)  # half of what the held steering jumps by
    assert a_x == pytest.approx(-data["v_y"] * data["r"])
    assert accelerations(data)[1] == pytest.approx(data["a_y"])
    found = sa.gg_diagram(data, CAR_AT_LIMIT)
    assert found.v == pytest.approx([20.0])
    figure = found.plot()
    assert len(figure.data) == 2
    assert "1500 samples" in repr(found)
    assert "99 % of samples" in found.table().to_text()


def test_forces_are_those_of_the_model():
    data = driven()
    found = sa.tire_use(data, CAR_AT_LIMIT)
    forces = []
    for k in range(len(data.t)):
        x = data["v_y"][k], data["r"][k]
        u = (data["delta"][k], 20.0)
        forces.append([float(f) for f in CAR_AT_LIMIT._forces(x, u, CAR_AT_LIMIT._slip(x, u))[:2]])
    exact = np.array(forces)
    kept = slice(3, -3)  # forces jump where the held steering does; a central difference is the mean of both sides
    assert found.F_y_f[kept] == pytest.approx(exact[kept, 0], abs=6e-3 * np.abs(exact).max())
    assert found.F_y_r[kept] == pytest.approx(exact[kept, 1], abs=6e-3 * np.abs(exact).max())
    load = CAR["mass"] * GRAVITY * CAR["l_f"] / CAR["wheelbase"]
    assert found.available_r == pytest.approx(np.full(1500, 0.8 * load), rel=1e-3)
    across = np.abs(found.F_y_r / found.available_r)
    assert (found.used_r >= across - 1e-12).all()
    assert found.used_r[np.argmax(across)] == pytest.approx(across.max(), rel=0.01)
    assert "grip used" in found.plot().layout.yaxis3.title.text
    assert "at most front" in repr(found)
    assert "front" in found.table().to_text()


def test_no_force_is_drawn_between_experiments():
    whole = driven()
    figure = sa.tire_use(sa.join(whole.rows(0, 200), whole.rows(400, 600)), CAR_AT_LIMIT).plot()
    for trace in figure.data:
        x, y = np.asarray(trace.x, dtype=float), np.asarray(trace.y, dtype=float)
        joined = np.diff(x)[np.isfinite(y[1:]) & np.isfinite(y[:-1])]
        assert joined.max() < 1.5 * whole.dt
        assert x[-1] == pytest.approx(whole.t[599])


def test_bad_input_is_said():
    data = driven()
    with pytest.raises(ParameterError, match="neither a log nor a car"):
        sa.gg_diagram()
    with pytest.raises(ParameterError, match="does not say how much its tires can hold"):
        sa.gg_diagram(data, BICYCLE)
    with pytest.raises(ParameterError, match="has no r"):
        sa.tire_use(only(data, "v_x", "v_y"), CAR_AT_LIMIT)
    with pytest.raises(ParameterError, match="not above 0"):
        sa.gg_diagram(car=CAR_AT_LIMIT, v_x=[-1.0])
    for wrong in (lambda: sa.gg_diagram(CAR_AT_LIMIT), lambda: sa.tire_use(CAR_AT_LIMIT, data)):
        with pytest.raises(ParameterError, match=r"the log is a \w+; expected a Dataset: it comes before the car"):
            wrong()
