"""Learned friction: a known curve comes back, a strong prior leaves physics alone."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.reproduce.plants.emps import Emps, EmpsParams, FrictionCurve
from slipangle.reproduce.plants.friction import FrictionFit

START = Emps(params=EmpsParams(mass=80.0, viscous=150.0, coulomb=15.0), dt=0.002, outputs=("q",))


@pytest.fixture(scope="module")
def record():
    """A drive with a Stribeck-like bump, pushed both ways at changing force."""
    rng = np.random.default_rng(0)
    curve = FrictionCurve(centres=[-0.06, -0.03, 0.03, 0.06], width=0.015, weights=[3.0, -2.0, -2.0, 3.0])
    true = Emps(params=EmpsParams(mass=92.0, viscous=180.0, coulomb=22.0, offset=-3.0), friction=curve, dt=0.002)
    force = np.repeat(60.0 * rng.standard_normal(24), 150)
    data = Dataset.from_arrays({"force": force}, {"q": np.zeros(len(force))}, 0.002, extra={"v": np.zeros(len(force))})
    run = true.simulate(data)
    return true, data.with_channel("q", run.channel("q")).with_channel("v", run.channel("v"))


def test_recovers_friction_and_mass(record):
    true, data = record
    model = FrictionFit(start=START, spacing=0.03, v_max=0.1, weight_std=30.0, error=(1e-4,), max_iterations=100).fit(
        data
    )
    assert model.params.mass == pytest.approx(92.0, rel=0.02)
    assert model.fit_info.noise_std[0] < 2e-4
    v = np.linspace(-0.12, 0.12, 25)

    def friction(m):
        p = m.params
        return p.viscous * v + p.coulomb * np.tanh(v / p.v_slip) + p.offset + m.friction.force(v)

    assert friction(model) == pytest.approx(friction(true), abs=1.5)


def test_strong_prior_leaves_physics_alone(record):
    _, data = record
    model = FrictionFit(start=START, spacing=0.05, weight_std=1e-6).fit(data)
    assert np.abs(model.friction.weights).max() < 1e-4
    assert model.fit_info.names[:4] == ("mass", "viscous", "coulomb", "offset")
    assert "weight at -150 mm/s" in model.fit_info.names


def test_bad_settings():
    with pytest.raises(ParameterError, match="no parameter 'mas'"):
        FrictionFit(start=START, free=("mas",))
    with pytest.raises(ParameterError, match="spacing is 0"):
        FrictionFit(start=START, spacing=0.0)
    with pytest.raises(ParameterError, match="2 typical errors for the outputs q"):
        FrictionFit(start=START, error=(1e-3, 1e-2))
    with pytest.raises(ParameterError, match="2 centres, 1 weights"):
        FrictionCurve(centres=[0.1, 0.2], width=0.1, weights=[1.0])
