"""Models with a single state are observed like any other."""

import numpy as np
import pytest

import slipangle as sa

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler")
LAG = sa.Ode(f=lambda x, u, p: [-p.a * x[0] + u[0]], states=("x",), inputs=("u",), params={"a": 1.0}, dt=0.1)
NOISE, WANDER = 0.05, 0.2


def driven(n=80):
    """The lag with noise, of the state too."""
    rng = np.random.default_rng(0)
    x, rows = np.zeros(1), []
    for u in rng.standard_normal(n):
        rows.append((u, x[0] + NOISE * rng.standard_normal()))
        x = np.asarray(LAG.step(x, np.array([u]))) + WANDER * np.sqrt(LAG.dt) * rng.standard_normal(1)
    u, y = np.array(rows).T
    return sa.Dataset.from_arrays({"u": u}, {"x": y}, LAG.dt)


DATA = driven()
FIRST_ORDER = sa.ARX(na=1, nb=1, nk=1, offset=False).fit(DATA)
MODELS = {"ode": LAG, "arx": FIRST_ORDER, "delayed": sa.Delayed(FIRST_ORDER, delays={"u": 0.1})}


def textbook(model, measured):
    """Estimate and standard deviation after each sample, by numbers alone."""
    step = [float(np.asarray(model.step(np.array([x]), np.array([u])))[0]) for x, u in ((0, 0), (1, 0), (0, 1))]
    assert step[0] == 0
    z, P, found = 0.0, NOISE**2, []
    for k, (_, y) in enumerate(measured):
        if k:
            z, P = step[1] * z + step[2] * measured[k - 1][0], step[1] ** 2 * P + WANDER**2 * model.dt
        gain = P / (P + NOISE**2) if np.isfinite(y) else 0.0
        z, P = z + gain * (np.nan_to_num(y) - z), (1 - gain) * P
        found.append((z, np.sqrt(P)))
    return np.array(found)


@pytest.mark.parametrize("make", [sa.EKF, lambda **s: sa.EKF(gate=8.0, **s), lambda **s: sa.MHE(horizon=4, **s)])
@pytest.mark.parametrize("name", ["ode", "arx"])
def test_it_is_the_textbook_filter(name, make):
    model = MODELS[name]
    measured = np.column_stack([DATA["u"], DATA["x"]])
    measured[20:23, 1] = np.nan
    (state,) = model.states
    settings = make(
        start=model, noise_std={model.outputs[0]: NOISE}, process_std={state: WANDER}, state_std={state: NOISE}
    )
    tracker, found = settings.start_at(np.zeros(1)), []
    for u, y in measured:
        tracker.update(np.array([y]), np.array([u]))
        found.append((tracker.state[0], tracker.state_std[0]))
    np.testing.assert_allclose(found, textbook(model, measured), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_it_runs_over_a_record_and_stays_near(name):
    model = MODELS[name]
    for make in (sa.EKF, sa.MHE):
        settings = make(start=model, noise_std={model.outputs[0]: NOISE}, process_std={model.states[0]: WANDER})
        run = settings.start_at().run(DATA)
        assert run.states.shape == (DATA.n_samples, model.n_states)
        assert np.sqrt(np.mean((run.states[:, 0] - DATA["x"]) ** 2)) < 2 * NOISE


def test_its_parameter_is_found():
    settings = sa.EKF(
        start=LAG.with_values(a=2.0),
        free=("a",),
        noise_std={"x": NOISE},
        process_std={"x": WANDER},
        prior_std={"a": 0.5},
    )
    tracker = settings.start_at()
    tracker.run(driven(600))
    assert abs(tracker.parameters[0] - 1.0) < 4 * tracker.parameters_std[0] < 0.8
