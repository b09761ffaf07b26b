"""A free run starts from a noisy sample: the intervals count that noise, of outputs and of states logged beside."""

import warnings

import numpy as np
import pytest

from slipangle import Ode, ops
from slipangle.data.dataset import Dataset, join
from slipangle.errors import IdentifiabilityWarning
from slipangle.identify.physics.first_sample import start_noise
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.wrappers.delayed import Delayed

DT, TRUE = 0.05, {"k": 4.0, "b": 0.5, "g": 1.0}


def mass(outputs=("x",), sine=False):
    """A mass on a spring, or a pendulum, whose transients last 80 samples."""
    return Ode(
        f=lambda x, u, p: [x[1], -p.k * (ops.sin(x[0]) if sine else x[0]) - p.b * x[1] + p.g * u[0]],
        states=("x", "v"),
        inputs=("u",),
        outputs=outputs,
        dt=DT,
        params={"k": (4.0, 0.1, 50.0), "b": (0.5, 0.01, 5.0), "g": (1.0, 0.1, 10.0)},
    )


def records(model, rng, count, noise=0.05, n=200, size=0.5):
    """From random states; the speed is logged with as much noise, an output or not."""
    both, made = model.resampled(DT, outputs=("x", "v")), []
    for _ in range(count):
        u = np.repeat(rng.choice([-1.0, 1.0], n // 10), 10)
        x = np.vstack([start := size * rng.standard_normal(2), both.free_run(start, u[:, None])])
        x = x + noise * rng.standard_normal(x.shape)
        seen = dict(zip(("x", "v"), x.T, strict=True))
        outputs = {name: seen.pop(name) for name in model.outputs}
        made.append(Dataset.from_arrays({"u": u}, outputs, DT, extra=seen))
    return join(*made).hold_sample()


def fitted(model, data, **more):
    start = model.model if isinstance(model, Delayed) else model
    start = start.with_values(k=3.0, b=0.4, g=1.2)
    start = Delayed(start, delays=model.delays, longest=model.longest) if isinstance(model, Delayed) else start
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        return GreyBox(start=start, free=tuple(TRUE), **more).fit(data).fit_info


@pytest.mark.parametrize(
    ("model", "count", "sets"),
    [
        (mass(), 1, 40),
        (mass(), 6, 24),
        (mass(("x", "v"), sine=True), 1, 40),
        *(
            pytest.param(model, count, 200, marks=pytest.mark.slow)
            for model in (mass(), mass(("x", "v")), mass(sine=True), mass(("x", "v"), sine=True))
            for count in (1, 6)
        ),
    ],
)
def test_intervals_hold_from_a_noisy_start(model, count, sets):
    off, std = [], []
    for seed in range(sets):
        info = fitted(model, records(model, np.random.default_rng(seed), count))
        off.append(info.values - list(TRUE.values()))
        std.append(info.std)
    rates = np.mean(np.abs(off) <= 1.96 * np.array(std), axis=0)
    assert (rates >= 0.94 - 3 * np.sqrt(0.94 * 0.06 / sets)).all(), rates
    assert (np.median(std, axis=0) < 1.4 * np.std(off, axis=0)).all()


def test_without_noise_nothing_is_added():
    info = fitted(mass(), records(mass(), np.random.default_rng(0), 2, noise=0.0))
    assert info.values == pytest.approx(list(TRUE.values()), rel=1e-7)
    assert info.std.max() < 1e-7


def test_sources_are_what_the_start_is_read_from():
    data = records(mass(), np.random.default_rng(0), 3).with_channel("idle", np.ones(600))
    for model, free, expected in (
        (mass(), False, 6),
        (mass(), True, 0),
        (Delayed(mass(), delays={"u": 0.0}, longest=0.1), False, 6),
    ):
        problem = GreyBox(start=model, free=tuple(TRUE), free_initial_state=free).problem(data)
        found = problem.minimise(problem.start, 50)
        assert start_noise(problem, found, found.jacobian).pull.shape == (len(found.z), expected)


def test_noise_of_a_logged_state_is_its_own():
    """Ten times as much noise on the speed, which is no output, is ten times as much in the intervals."""
    quiet, loud = (records(mass(), np.random.default_rng(0), 6) for _ in range(2))
    clean = records(mass(), np.random.default_rng(0), 6, noise=0.0)
    loud = loud.with_channel("v", clean["v"] + 10 * (quiet["v"] - clean["v"]))
    pulls = []
    for data in (quiet, loud):
        problem = GreyBox(start=mass(), free=tuple(TRUE)).problem(data)
        found = problem.minimise(problem.start, 50)
        pulls.append(np.linalg.norm(start_noise(problem, found, found.jacobian).pull[:, 1::2] * found.sigma[0]))
    assert 4 < pulls[1] / pulls[0] < 16
