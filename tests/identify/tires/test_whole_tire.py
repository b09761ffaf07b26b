"""Whole tires from rig data: parameters come back, neural tires follow, bad data get one sentence."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.readers.ttc import from_channels
from slipangle.data.tire_data import TireData, joined
from slipangle.errors import ExcitationError, IdentifiabilityWarning, ParameterError, TooShortError
from slipangle.identify.tires.curves import MagicCurveFit, MLPCurveFit, RBFCurveFit
from slipangle.identify.tires.whole_tire import CurveTireFit, TireFit
from slipangle.models.tires.neural import NeuralTire
from slipangle.models.tires.physical import BrushTire, DugoffTire
from slipangle.models.tires.simple import LinearTire, SimpleMagicFormula
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_8
from slipangle.numerics.multistart import Effort
from tests.rig import UNITS, channels

QUICK = Effort(starts=6, carried=2, polish=80, finish=80)
BRUSH = BrushTire(C_alpha=6e4, C_s=8e4, mu=1.1, half_length=0.08)
DUGOFF = DugoffTire(C_alpha=6e4, C_s=8e4, mu=1.1)
LINEAR = LinearTire(C_alpha=6e4, C_s=8e4)


def measured(tire, *, noise=30.0, seed=0, loads=(2e3, 4e3, 6e3)):
    """Pure and combined slip of a tire, with noise in its forces."""
    rng = np.random.default_rng(seed)
    parts = []
    for load in loads:
        swing = np.linspace(-1, 1, 121)
        parts += [(0.2 * swing, 0 * swing, load), (0 * swing, 0.25 * swing, load), (0.2 * swing, 0.1 + 0 * swing, load)]
        parts += [(0.2 * swing, -0.1 + 0 * swing, load)]
    s, a, f = (np.concatenate([np.broadcast_to(p[k], 121) for p in parts]) for k in range(3))
    out = tire.forces(s, a, f)
    moment = out.M_z + noise * 0.05 * rng.standard_normal(len(s))
    return TireData(
        slip_ratio=s,
        slip_angle=a,
        load=f,
        F_x=out.F_x + noise * rng.standard_normal(len(s)),
        F_y=out.F_y + noise * rng.standard_normal(len(s)),
        M_z=moment,
    )


@pytest.mark.parametrize(
    ("true", "start", "free", "outputs"),
    [
        (BRUSH, BrushTire(C_alpha=2e4, C_s=3e5, mu=0.6, half_length=0.02), ("C_alpha", "C_s", "mu"), ()),
        (
            BRUSH,
            BrushTire(C_alpha=2e4, C_s=3e5, mu=0.6, half_length=0.02),
            ("C_alpha", "C_s", "mu", "half_length"),
            ("F_x", "F_y", "M_z"),
        ),
        (DUGOFF, DugoffTire(C_alpha=2e5, C_s=2e4, mu=2.0), ("C_alpha", "C_s", "mu"), ()),
        (LINEAR, LinearTire(C_alpha=1e4, C_s=1e6), ("C_alpha", "C_s"), ("F_x", "F_y")),
    ],
    ids=["brush", "brush with trail", "dugoff", "linear"],
)
@pytest.mark.parametrize("seed", range(3))
def test_parameters_are_recovered_within_their_intervals(true, start, free, outputs, seed):
    loads = (2e4, 4e4) if true is LINEAR else (2e3, 4e3, 6e3)  # a linear tire has no limit: keep friction plausible
    found = TireFit(start=start, free=free, outputs=outputs, effort=QUICK).fit(measured(true, seed=seed, loads=loads))
    info = found.fit_info
    assert info.names == free
    for name, value, std in zip(free, info.values, info.std, strict=True):
        assert getattr(found, name) == value
        assert abs(value - getattr(true, name)) < 4 * std
        assert std < 0.03 * value
    assert info.noise_std[0] == pytest.approx(30.0, rel=0.1)


def test_linear_range_only():
    data = measured(BRUSH)
    near = TireFit(start=LINEAR, free=("C_alpha", "C_s"), slip_limit=0.02).fit(data)
    assert near.C_alpha == pytest.approx(BRUSH.C_alpha, rel=0.2)
    far = TireFit(start=LINEAR, free=("C_alpha", "C_s")).fit(data)
    assert far.C_alpha < 0.6 * near.C_alpha
    with pytest.raises(TooShortError, match="raise slip_limit"):
        TireFit(start=LINEAR, free=("C_alpha", "C_s"), slip_limit=1e-9).fit(data.rows(np.s_[:60]))


def test_what_the_data_do_not_determine_is_named():
    data = measured(BRUSH).rows(np.s_[121:242])  # lateral sweep of one load
    with pytest.warns(IdentifiabilityWarning, match="do not determine C_s"):
        TireFit(start=BRUSH, free=("C_alpha", "C_s"), outputs=("F_y",)).fit(data)


def test_magic_curves_from_rig_data():
    data = measured(SOUSA_TABLE_6_8, loads=(600.0, 601.0), noise=5.0)
    fit = CurveTireFit(longitudinal=MagicCurveFit(level=None), lateral=MagicCurveFit(level=None))
    tire = fit.fit(data)
    assert isinstance(tire, SimpleMagicFormula)
    assert pytest.approx(SOUSA_TABLE_6_8.longitudinal.D, rel=0.02) == tire.longitudinal.D
    assert pytest.approx(SOUSA_TABLE_6_8.lateral.D, rel=0.02) == tire.lateral.D
    assert tire.longitudinal.fit_info is not None
    slip = np.linspace(-0.2, 0.2, 50)
    assert tire.lateral(slip) == pytest.approx(SOUSA_TABLE_6_8.lateral(slip), abs=0.02)


@pytest.mark.parametrize("inputs", [(), ("load",), ("load", "camber")])
def test_neural_tire_from_rig_runs(inputs):
    runs = [from_channels(channels(kind, seed=k), UNITS) for k, kind in enumerate(("cornering", "drive/brake"))]
    data = joined(runs)
    fit = MLPCurveFit(hidden=(3, 3), effort=QUICK)
    tire = CurveTireFit(longitudinal=fit, lateral=fit, inputs=inputs, samples=900).fit(data)
    assert isinstance(tire, NeuralTire)
    assert tire.lateral.inputs == ("slip", *inputs)
    rolling = np.abs(data.slip_ratio) < 0.01
    part = data.rows(rolling)
    error = part.F_y - tire.forces(0.0, part.slip_angle, part.load, camber=part.gamma).F_y
    relative = np.sqrt(np.mean((error / part.load) ** 2))
    assert relative < {0: 0.25, 1: 0.2, 2: 0.05}[len(inputs)]


def test_a_known_curve_is_kept():
    data = measured(SOUSA_TABLE_6_8, loads=(600.0,), noise=5.0)
    lateral = data.rows(np.abs(data.slip_ratio) < 0.01)
    with pytest.raises(ExcitationError, match=r"no sweep of slip ratio .* give the curve of that direction"):
        CurveTireFit(longitudinal=MagicCurveFit(), lateral=MagicCurveFit()).fit(lateral)
    known = SOUSA_TABLE_6_8.longitudinal
    tire = CurveTireFit(longitudinal=known, lateral=MagicCurveFit(level=None), combined="ellipse").fit(lateral)
    assert tire.longitudinal is known
    assert tire.combined == "ellipse"


def test_one_side_is_not_enough():
    data = measured(BRUSH)
    right = data.rows(data.slip_angle >= 0)
    with pytest.raises(
        ExcitationError, match=r"slip angle of 'tire data' runs from 0 to 0\.25, on one side of zero only"
    ):
        TireFit(start=BRUSH, free=("C_alpha",), outputs=("F_y",)).fit(right)
    both = joined([right, right.mirrored()])
    assert TireFit(start=BRUSH, free=("C_alpha",), outputs=("F_y",)).fit(both).C_alpha == pytest.approx(6e4, rel=0.02)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TireFit(start=BRUSH, free=("C_beta",)), "no parameter 'C_beta'"),
        (lambda: TireFit(start=BRUSH, free=()), "no parameter is free"),
        (lambda: TireFit(start=BRUSH, free=("mu",), outputs=("F_q",)), "outputs is .*'F_q'.*use one of these"),
        (
            lambda: TireFit(start=SOUSA_TABLE_6_8, free=("B",)),
            "SimpleMagicFormula; expected a tire that is a parameter",
        ),
        (lambda: CurveTireFit(longitudinal=MagicCurveFit()), "expected both alike"),
        (
            lambda: CurveTireFit(longitudinal=MagicCurveFit(), lateral=MagicCurveFit(), inputs=("load",)),
            "depend on slip alone",
        ),
        (lambda: CurveTireFit(longitudinal=RBFCurveFit(neurons=2), inputs=("lode",)), "'lode'.*; nearest are 'load'"),
        (
            lambda: TireFit(start=BRUSH, free=("mu",), outputs=("M_x",)).fit(measured(BRUSH)),
            "holds no M_x; expected outputs that were measured",
        ),
    ],
)
def test_bad_settings(make, message):
    with pytest.raises(ParameterError, match=message):
        make()


def test_no_sweep():
    data = measured(BRUSH)
    still = replace(data, slip_ratio=0 * data.load, slip_angle=0 * data.load)
    with pytest.raises(ExcitationError, match="neither slip ratio nor slip angle"):
        TireFit(start=BRUSH, free=("mu",)).fit(still)
