"""Samples are known again by content: renamed, cut, moved in time, from a file; and nothing else is."""

import json
from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ModelWarning, ParameterError
from slipangle.identify.judge.validate import require_unseen, validate
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.recursive import RLS
from slipangle.models.provenance import WINDOW, fingerprint, overlap
from slipangle.models.storage import load, save
from slipangle.models.wrappers.ensemble import EnsembleModel

pytestmark = pytest.mark.filterwarnings("ignore:the data have a level")  # of a square
DT = 0.02


def log(seed, n=3000, quantum=0.0, name="data"):
    """Noise through a first-order lag, read by a sensor of finite resolution, from t = 0."""
    rng = np.random.default_rng(seed)
    u, y = rng.standard_normal(n), np.zeros(n)
    for k in range(n - 1):
        y[k + 1] = 0.9 * y[k] + 0.1 * u[k]
    y += 0.01 * rng.standard_normal(n)
    z = np.r_[0.0, y[:-1] ** 2] + 0.01 * rng.standard_normal(n)
    y, z = (np.round(s / quantum) * quantum if quantum else s for s in (y, z))
    return Dataset.from_arrays({"u": u}, {"y": y, "z": z}, DT, name=name)


def pieces(data):
    return join(*(data.rows(a, a + 500) for a in (2000, 500, 1000)))


def moved(data):
    return replace(data, start_times=tuple(t + 123.4 for t in data.start_times))


def detrended(data):
    return data.detrend()[0]


def wider(data):
    return data.with_channel("more", np.ones(data.n_samples)).select(inputs=["u"], outputs=["z", "more", "y"])


def rounded(data):
    return replace(data, values=data.values * (1 + 1e-15))


def one_piece(data):
    """Pieces run together, no border between them."""
    return replace(pieces(data), starts=(0,), start_times=(0.0,))


DISGUISES = {
    "none": lambda data: data,
    "another name": lambda data: replace(data, name="test run"),
    "another time": moved,
    "pieces": pieces,
    "one piece": one_piece,
    "other columns": wider,
    "means held": Dataset.hold_mean,
    "last bit": rounded,
    "means subtracted": detrended,
    "pieces, means subtracted": lambda data: detrended(pieces(data)),
    "its last quarter, then new data": lambda data: join(data.rows(2250, 3000), log(9)),
    "its first tenth": lambda data: data.rows(0, 300),
    "a stretch inside": lambda data: data.rows(1234, 1300),
}


@pytest.mark.parametrize("quantum", [0.0, 0.02])
@pytest.mark.parametrize("disguise", DISGUISES.values(), ids=DISGUISES)
def test_the_same_samples_are_refused(disguise, quantum):
    train = log(0, quantum=quantum)
    model = ARX(na=2, nb=2).fit(train)
    with pytest.raises(ParameterError, match="used to fit the model"):
        require_unseen(model, disguise(train))


@pytest.mark.parametrize("quantum", [0.0, 0.02, 0.2])
def test_other_samples_of_the_same_name_and_time_are_not(quantum):
    model = ARX(na=2, nb=2).fit(log(0, quantum=quantum))
    for seed in range(1, 8):
        require_unseen(model, log(seed, quantum=quantum))
    train, test = log(0, quantum=quantum).split(0.7)
    require_unseen(ARX(na=2, nb=2).fit(train), test)


def test_another_offset_makes_no_new_data():
    """Fitted without the means and judged with them, too, all samples counted; noise anew makes new data."""
    train, other = log(0), log(1)
    seen = fingerprint(detrended(train), train.outputs)
    assert overlap(seen, train).rows.all()
    assert overlap(seen, moved(train)).earlier == 0.0
    assert overlap(seen, other) is None
    assert overlap(seen, detrended(other)) is None


def test_the_sentence_says_how_many_and_from_where():
    train = log(0, name="monday")
    test = replace(join(log(1), train.rows(1000, 3000)), name="tuesday")
    test = replace(test, start_times=(0.0, 500.0))
    with pytest.raises(ParameterError) as refused:
        validate(ARX(na=2, nb=2).fit(train), test)
    assert str(refused.value).startswith(
        "2000 of 5000 samples of 'tuesday' (from t = 500 s) were used to fit the model, under the name 'monday' at t = "
        "20 s; expected other data"
    )


def test_one_experiment_among_several_is_found():
    runs = [log(seed) for seed in range(4)]
    model = ARX(na=2, nb=2).fit(join(*runs[:3]))
    require_unseen(model, runs[3])
    test = join(runs[3], runs[1])
    with pytest.raises(ParameterError, match="3000 of 6000 samples of 'data' \\(from t = 0 s\\)"):
        require_unseen(model, test)


def test_standing_still_in_both_is_no_overlap():
    """A car waits at a light before and after; only the drive itself is content."""

    def drive(seed):
        n = 20_000
        values = np.zeros((n, 2))
        values[9000:9400] = np.random.default_rng(seed).standard_normal((400, 2))
        return Dataset.from_arrays({"u": values[:, 0]}, {"y": values[:, 1]}, DT)

    model = ARX(na=1, nb=1).fit(drive(0))
    require_unseen(model, drive(1))
    with pytest.raises(ParameterError, match="used to fit"):
        require_unseen(model, replace(drive(0), name="other"))


def test_steps_between_two_levels_count_at_their_own_time_only():
    """A switch has too few values to be known by them: two of its records agree in many windows by chance."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.integers(0, 2, 300), 7).astype(float)
    data = Dataset.from_arrays({"u": u}, {"y": np.r_[0.0, u[:-1]]}, DT)
    seen = fingerprint(data, data.outputs)
    assert not seen.lively.any()
    assert overlap(seen, replace(data, name="again")).rows.all()
    assert overlap(seen, moved(data)) is None
    other = np.repeat(rng.integers(0, 2, 300), 7).astype(float)
    assert overlap(seen, Dataset.from_arrays({"u": other}, {"y": other}, DT)) is None


@pytest.mark.parametrize("n", [2, WINDOW - 1, WINDOW, WINDOW + 1, 50])
def test_short_records(n):
    data = log(0).rows(100, 100 + n)
    seen = fingerprint(data, data.outputs)
    assert (overlap(seen, data) is not None) == (n >= WINDOW)
    assert overlap(seen, log(1)) is None


def test_it_survives_a_file_and_old_files_have_the_name(tmp_path):
    train = log(0, name="lap 1")
    path = save(ARX(na=2, nb=2).fit(train), tmp_path / "new.json")
    assert path.stat().st_size < 20_000
    with pytest.raises(ParameterError, match="used to fit"):
        require_unseen(load(path), replace(train, name="lap 2"))
    for name in ("lap 1", "data"):
        content = json.loads(save(ARX(na=2, nb=2).fit(replace(train, name=name)), path).read_text())
        del content["record"]["fields"]["fit_info"]["fields"]["fingerprint"]
        path.write_text(json.dumps(content))
        old = load(path)
        assert old.fit_info.fingerprint is None
        require_unseen(old, replace(train, name="lap 2"))
        if name == "lap 1":
            with pytest.raises(ParameterError, match="used to fit"):
                require_unseen(old, train)
        else:
            with pytest.warns(ModelWarning, match="cannot be told"):
                require_unseen(old, replace(train, name=name))


def test_models_inside_a_model_are_asked_too():
    first, second, third = (log(seed) for seed in range(3))
    members = tuple(ARX(na=2, nb=2).fit(data) for data in (first, second))
    ensemble = EnsembleModel(members=members)
    require_unseen(ensemble, third)
    with pytest.raises(ParameterError, match="used to fit"):
        require_unseen(ensemble, second)


def test_recursive_fits_keep_it_too():
    model = RLS(na=2, nb=2).fit(log(0))
    require_unseen(model, log(1))
    with pytest.raises(ParameterError, match="used to fit"):
        require_unseen(model, replace(log(0), name="again"))
