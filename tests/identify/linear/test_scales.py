"""State spaces do not hang on the units of their channels: the same record, its signals multiplied by numbers."""

import numpy as np
import pytest
from scipy import signal

import slipangle as sa
from slipangle.identify.linear.pem import PEM
from slipangle.identify.linear.scales import Scales
from slipangle.identify.linear.subspace import Subspace

DT, N = 0.1, 1200
TWO = {"u": 2.0**7, "w": 2.0**-9, "y": 2.0**-13, "z": 2.0**13}
TEN = {"u": 1e3, "w": 1e-3, "y": 1e-4, "z": 1e4}


def log(by=None, *, level=0.0, parts=1, seed=1):
    """Two inputs, two outputs and a channel that rides along, each multiplied by its number."""
    rng = np.random.default_rng(seed)
    u, w = rng.standard_normal(N), rng.standard_normal(N)
    y = signal.lfilter([0, 0, 1, 0.5], [1, -1.5, 0.7], u) + 0.1 * rng.standard_normal(N)
    z = signal.lfilter([0, 0.3], [1, -0.8], w) + 0.2 * signal.lfilter([0, 0.1], [1, -0.9], u)
    signals = {"u": u + level, "w": w, "y": y + level, "z": z + 0.02 * rng.standard_normal(N)}
    signals = {name: x * (by or {}).get(name, 1.0) for name, x in signals.items()}
    pick = {role: {n: signals[n] for n in names} for role, names in (("inputs", "uw"), ("outputs", "yz"))}
    data = sa.Dataset.from_arrays(**pick, dt=DT, extra={"still": np.ones(N)})
    return data if parts == 1 else sa.join(*(data.rows(a, a + N // parts) for a in range(0, N, N // parts)))


def back(model, by):
    """Its matrices, levels and first states in the units of the record that nothing was multiplied in."""
    u, y = (np.array([by[n] for n in names]) for names in ("uw", "yz"))
    wide = y[:, None]
    parts = {"A": model.A, "B": model.B * u, "C": model.C / wide, "D": model.D * u / wide, "K": model.K * y}
    parts |= {"u_offset": model.u_offset / u, "y_offset": model.y_offset / y}
    return parts | ({} if model.x0 is None else {"x0": model.x0})


WAYS = {
    "subspace": (Subspace(order=4), {}),
    "subspace, n4sid": (Subspace(order=4, algorithm="n4sid", direct=True), {}),
    "subspace, level": (Subspace(order=4, algorithm="moesp", offset=True), {"level": 3.0}),
    "free run": (sa.StateSpace(order=4), {"parts": 3}),
    "predictor": (sa.StateSpace(order=3, focus="prediction", direct=True), {}),
    "levels": (sa.StateSpace(order=3, offsets="both", weights="output"), {"level": 3.0, "parts": 2}),
}


@pytest.mark.parametrize("way", WAYS)
def test_powers_of_two_change_nothing(way):
    estimator, kind = WAYS[way]
    plain, other = estimator.fit(log(**kind)), estimator.fit(log(TWO, **kind))
    for name, value in back(other, TWO).items():
        assert value == pytest.approx(getattr(plain, name), rel=1e-9, abs=1e-12), name
    sizes = np.array([TWO["y"], TWO["z"]])
    assert other.fit_info.noise_std / sizes == pytest.approx(plain.fit_info.noise_std, rel=1e-9)
    t, s = plain.fit_info, other.fit_info
    known = t.std > 0
    assert (s.std / np.abs(s.values))[known] == pytest.approx((t.std / np.abs(t.values))[known], rel=1e-9)


def test_estimates_are_the_entries_of_the_model():
    for model in (Subspace(order=3, offset=True, direct=True).fit(log(TEN)), sa.StateSpace(order=3).fit(log(TEN))):
        for name, value in zip(model.fit_info.names, model.fit_info.values, strict=True):
            what, _, place = name[:-1].partition("[")
            at = tuple(int(k) if k.isdigit() else model.outputs.index(k) for k in place.split(","))
            assert getattr(model, what)[at] == pytest.approx(value, rel=1e-12), name


def test_in_other_units_the_same_orders_and_fits_come_out():
    """Of outputs in micrometres and newtons, say: 1e-4 and 1e4 of their usual size."""
    found = []
    for by in (None, TEN):
        train, test = log(by).split(2 / 3)
        model = sa.StateSpace().fit(train)
        scores = sa.validate(model, test, train=train).free_run_scores
        found.append((model.order, {name: score.fit for name, score in scores.items()}))
    assert found[0][0] == found[1][0]
    assert found[1][1] == pytest.approx(found[0][1], abs=0.02)
    assert min(found[1][1].values()) > 95
    plain, other = (sa.StateSpace(order=(2, 3, 4, 5)).choose_order(log(by)) for by in (None, TEN))
    assert other.order == plain.order
    assert other.errors == pytest.approx(plain.errors, rel=1e-3)


def test_weights_are_in_the_units_of_the_outputs():
    plain = sa.StateSpace(order=3, weights=(0.1, 0.02)).fit(log())
    other = sa.StateSpace(order=3, weights=(0.1 * TWO["y"], 0.02 * TWO["z"])).fit(log(TWO))
    assert back(other, TWO)["A"] == pytest.approx(plain.A, rel=1e-9, abs=1e-12)
    assert np.abs(other.A - sa.StateSpace(order=3, weights=(100.0, 0.02)).fit(log()).A).max() > 1e-3


def test_a_start_is_taken_along():
    start = sa.StateSpace(order=4).fit(log(TEN))
    again = PEM(start=start, focus="simulation").fit(log(TEN))
    run = [m.simulate(log(TEN)).predicted for m in (start, again)]
    assert run[1] == pytest.approx(run[0], rel=1e-5, abs=1e-5 * np.abs(run[0]).max())


def test_a_record_is_known_again_by_its_own_numbers():
    train = log(TEN)
    model = sa.StateSpace(order=3).fit(train)
    assert model.fit_info.fingerprint.low == pytest.approx(train.y.min(axis=0))


def test_scaled_data_are_left_as_they_are():
    once = Scales.of(log(TEN))
    assert np.std(once.data.y, axis=0) == pytest.approx(1.0)
    assert Scales.of(once.data).data is once.data
    assert once.data["still"] == pytest.approx(1.0)
