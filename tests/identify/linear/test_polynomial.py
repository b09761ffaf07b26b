"""ARMAX, output-error, Box-Jenkins: true coefficients inside their intervals, ARX as a special case, refusals."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ExcitationError, IdentifiabilityWarning, ModelWarning, ParameterError, TooShortError
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.polynomial import ARMAX, BoxJenkins, OutputError, Polynomial
from slipangle.identify.linear.polynomial_search import Layout, Structured
from slipangle.identify.linear.statespace import StateSpace
from slipangle.models.black_box.polynomial import PolynomialModel, one

ARMAX_TRUE = {"A": [-1.5, 0.7], "B": [[1.0, 0.5], [0.3]], "C": [0.6], "D": [], "F": [[], []]}
OE_TRUE = {"A": [], "B": [[1.0, 0.5], [0.3]], "C": [], "D": [], "F": [[-1.5, 0.7], [-0.8]]}
BJ_TRUE = {"A": [], "B": [[1.0, 0.5], [0.3]], "C": [0.5], "D": [-0.9], "F": [[-1.5, 0.7], [-0.8]]}
CASES = {
    "ARMAX": (ARMAX(na=2, nb=(2, 1), nc=1, nk=(1, 2)), ARMAX_TRUE),
    "OE": (OutputError(nb=(2, 1), nf=(2, 1), nk=(1, 2)), OE_TRUE),
    "BJ": (BoxJenkins(nb=(2, 1), nf=(2, 1), nc=1, nd=1, nk=(1, 2)), BJ_TRUE),
}


@pytest.mark.parametrize(
    ("estimator", "true", "said"),
    [
        (ARMAX(na=2, nb=2, nc=1), "noise on the output", 20),
        (ARMAX(na=2, nb=2, nc=2), "noise on the output", 0),
        (ARMAX(na=2, nb=2, nc=1), "ARMAX", 0),
        (StateSpace(order=2, focus="prediction"), "ARMAX", 0),
        (StateSpace(order=2, focus="prediction"), "drift", 20),
        (BoxJenkins(nb=2, nf=2, nc=1, nd=1), "noise on the output", 0),
    ],
)
def test_noise_of_a_higher_order_that_shares_the_poles_is_said(estimator, true, said):
    """Noise that the model has no order for bends the poles that system and noise share; Box-Jenkins has its own."""
    count = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        u, e = rng.standard_normal((2, 800))
        v = {
            "noise on the output": 0.3 * e,
            "ARMAX": lfilter([0.1, 0.06], [1, -1.5, 0.7], e),
            "drift": lfilter([0.3], [1, -0.9], e),
        }[true]
        data = Dataset.from_arrays({"u": u}, {"y": lfilter([0, 0.2, 0.1], [1, -1.5, 0.7], u) + v}, 0.1)
        count += any("the model has too low an order for it" in s for s in estimator.fit(data).fit_info.warnings)
    assert abs(count - said) <= 1


def record(true, n, seed, noise, level=0.0):
    """The difference equation itself, filter by filter."""
    rng = np.random.default_rng(seed)
    u, e = rng.standard_normal((n + 100, 2)), noise * rng.standard_normal(n + 100)
    inner = lfilter(one(true["C"]), one(true["D"]), e)
    for i, nk in enumerate((1, 2)):
        inner = inner + lfilter(np.r_[np.zeros(nk), true["B"][i]], one(true["F"][i]), u[:, i])
    y = lfilter([1.0], one(true["A"]), inner)[100:] + level
    return Dataset.from_arrays({"u0": u[100:, 0], "u1": u[100:, 1]}, {"y": y}, 0.1)


def vector(true):
    return np.concatenate([true["A"], *true["B"], *true["F"], true["C"], true["D"]])


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", range(3))
def test_true_coefficients_inside_their_intervals(case, seed):
    estimator, true = CASES[case]
    model = estimator.fit(record(true, 3000, seed, 0.5))
    info = model.fit_info
    assert np.abs((info.values - vector(true)) / info.std).max() < 4
    assert info.std.max() < 0.15
    assert info.noise_std[0] == pytest.approx(0.5, rel=0.05)
    assert len(info.names) == len(vector(true))


@pytest.mark.parametrize("case", CASES)
def test_clean_data_give_the_exact_system(case):
    estimator, true = CASES[case]
    model = estimator.fit(record(true, 400, 7, 0.0))
    response = []
    for polynomials in (true, {k: getattr(model, k) for k in "ABCDF"}):
        pulse = np.eye(1, 60)[0]
        for i, nk in enumerate((1, 2)):
            both = np.convolve(one(polynomials["A"]), one(polynomials["F"][i]))
            response.append(lfilter(np.r_[np.zeros(nk), polynomials["B"][i]], both, pulse))
    assert response[2] == pytest.approx(response[0], abs=1e-6)
    assert response[3] == pytest.approx(response[1], abs=1e-6)


FULL_TRUE = {"A": [-0.6], "B": [[1.0, 0.5], [0.3]], "C": [0.5], "D": [-0.7], "F": [[-1.2, 0.5], [-0.4]]}
EVERY = {name: true for name, (_, true) in CASES.items()} | {"all five": FULL_TRUE}


def settings(true, **more):
    """Orders of given polynomials."""
    counts = {f"n{k.lower()}": len(true[k]) for k in "ACD"}
    return Polynomial(**counts, **{f"n{k.lower()}": tuple(map(len, true[k])) for k in "BF"}, nk=(1, 2), **more)


@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize("case", EVERY)
def test_derivatives_are_those_of_the_cost(case, offset):
    """Two experiments, away from the minimum, initial states eliminated."""
    true = EVERY[case]
    data = join(*(record(true, n, n, 0.5, level=2.0 * offset) for n in (200, 150)))
    wanted = settings(true, offset=offset)
    theta = vector(true) * (1 + 0.05 * np.random.default_rng(0).standard_normal(len(vector(true))))
    layout = Layout(wanted, data)
    start = layout.model(theta, data, np.array([0.1, 0.2]) * offset, 1.5 * offset)
    problem = Structured(wanted, layout, start, theta, data)
    point = problem._with_initial_states(problem.point)
    work, moves = problem.linearise(point)
    d = moves.shape[1]
    assert d == len(theta) + offset

    def cost(eta):
        return problem.cost(problem._with_initial_states(problem.moved(point, moves @ eta, 0 * point.x0)))

    numeric = np.array([(cost(e) - cost(-e)) / 2e-6 for e in 1e-6 * np.eye(d)])
    exact = -2 * work.shared[:d, :d].T @ work.shared[:d, d]
    assert exact == pytest.approx(numeric, abs=1e-7 * np.abs(numeric).max())


@pytest.mark.parametrize("case", EVERY)
def test_experiments_start_from_their_own_states(case):
    """Many short experiments with transients give what one long does; nothing is carried over."""
    true = EVERY[case]
    data = record(true, 3000, 11, 0.3)
    cut = replace(data, starts=tuple(range(0, 3000, 150)), start_times=tuple(float(k) for k in range(20)))
    info = settings(true).fit(cut).fit_info
    assert np.abs((info.values - vector(true)) / info.std).max() < 4
    shuffled = join(*(cut.experiments[i] for i in np.random.default_rng(0).permutation(20)))
    again = settings(true).fit(shuffled).fit_info
    assert again.values == pytest.approx(info.values, abs=1e-3 * info.std.max())


def test_a_disturbance_that_cannot_be_inverted_is_replaced_by_one_that_can():
    """C with a root outside the circle: the mirrored one has the same spectrum and a larger innovation."""
    true = {**ARMAX_TRUE, "C": [2.0]}
    model = ARMAX(na=2, nb=(2, 1), nc=1, nk=(1, 2)).fit(record(true, 6000, 12, 0.3))
    assert model.C == pytest.approx([0.5], abs=0.06)
    assert model.fit_info.noise_std == pytest.approx([0.6], rel=0.05)


def test_an_unstable_system_is_found_from_its_one_step_errors():
    """ARMAX with a pole at 1.02 under feedback."""
    rng, n = np.random.default_rng(0), 1500
    y, u, e = np.zeros(n), np.zeros(n), 0.1 * rng.standard_normal(n)
    for k in range(1, n):
        y[k] = 1.02 * y[k - 1] + 0.5 * u[k - 1] + e[k] + 0.4 * e[k - 1]
        u[k] = -0.3 * y[k] + rng.standard_normal()
    with pytest.warns(ModelWarning, match="unstable"):
        model = ARMAX(na=1, nb=1, nc=1).fit(Dataset.from_arrays({"u": u}, {"y": y}, 0.1))
    off = (model.fit_info.values - [-1.02, 0.5, 0.4]) / model.fit_info.std
    assert np.abs(off).max() < 4
    assert np.abs(model.poles).max() > 1.0


@pytest.mark.parametrize("case", EVERY)
def test_feedthrough(case):
    """The first input acts at once."""
    true = EVERY[case]
    wanted = replace(settings(true), nk=(0, 2))
    data = record(true, 2501, 13, 0.3)
    ahead = Dataset.from_arrays({"u0": data["u0"][:-1], "u1": data["u1"][1:]}, {"y": data["y"][1:]}, 0.1)
    model = wanted.fit(ahead)
    assert np.abs((model.fit_info.values - vector(true)) / model.fit_info.std).max() < 4.5
    assert "b0[u0]" in model.fit_info.names
    pulse = Dataset.from_arrays({"u0": np.eye(1, 60, 40)[0], "u1": np.zeros(60)}, {"y": np.zeros(60)}, 0.1)
    run = model.simulate(pulse).y[40:, 0]
    both = np.convolve(one(model.A), one(model.F[0]))
    assert run == pytest.approx(lfilter(model.B[0], both, np.eye(1, 20)[0]), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize("case", EVERY)
def test_intervals_hold_their_level(case, offset):
    """Errors over their standard deviations are standard normal over many records, long enough for the asymptotics."""
    true = EVERY[case]
    whole = []
    for seed in range(80):
        info = settings(true, offset=offset).fit(record(true, 2000, 1000 + seed, 0.5, level=3.0 * offset)).fit_info
        n = len(vector(true))
        whole.append((info.values[:n] - vector(true)) / info.std[:n])
    spread = np.sqrt(np.mean(np.square(whole), axis=0))
    assert spread == pytest.approx(np.ones(len(spread)), abs=0.3)
    inside = np.mean(np.abs(whole) < 1.96)
    assert inside == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize("case", EVERY)
def test_realisation_is_the_difference_equation(case):
    true = EVERY[case]
    model = PolynomialModel(**true, nk=(1, 2), dt=0.1, inputs=("u0", "u1"), outputs=("y",))
    data = record(true, 500, 3, 0.3)
    run = model.predict(data)
    u, y = data.u, data.y[:, 0]
    shape = one(true["C"]), one(true["D"])
    inner = lfilter(one(true["A"]), [1.0], y)
    for i, nk in enumerate((1, 2)):
        inner = inner - lfilter(np.r_[np.zeros(nk), true["B"][i]], one(true["F"][i]), u[:, i])
    residual = lfilter(shape[1], shape[0], inner)
    assert run.error[200:, 0] == pytest.approx(residual[200:], abs=1e-6)  # both have forgotten how they started


def test_arx_is_the_special_case():
    data = join(record(ARMAX_TRUE, 300, 1, 0.5), record(ARMAX_TRUE, 200, 2, 0.5))
    plain = ARX(na=2, nb=2).fit(data)
    same = Polynomial(na=2, nb=2).fit(data)
    assert same.A == pytest.approx(plain.A[:, 0, 0], abs=1e-6)
    assert np.array(same.B) == pytest.approx(plain.B[:, 0, :].T, abs=1e-6)


def test_offset_is_estimated():
    estimator = BoxJenkins(nb=(2, 1), nf=(2, 1), nc=1, nd=1, nk=(1, 2), offset=True)
    model = estimator.fit(record(BJ_TRUE, 3000, 4, 0.2, level=50.0))
    assert model.y_offset == pytest.approx(50.0, abs=5 * model.fit_info.std[-1] + 0.3)
    assert model.fit_info.names[-1] == "y_offset[y]"
    assert model.A.size == 0


def test_output_error_minimises_the_free_run():
    train, test = record(OE_TRUE, 1500, 5, 1.5).split(0.6)
    runs = {}
    for name, estimator in {"ARX": ARX(na=2, nb=2), "OE": OutputError(nb=2, nf=2, max_radius=1.0)}.items():
        run = estimator.fit(train).simulate(test)
        runs[name] = np.sqrt(np.mean(run.error[run.predicted] ** 2))
    assert runs["OE"] < runs["ARX"]


def test_pole_limit_holds():
    true = {**OE_TRUE, "F": [[-1.9, 0.905], [-0.8]]}
    with pytest.warns(ModelWarning, match="a pole ends at the limit of 0.9:"):
        model = OutputError(nb=(2, 1), nf=(2, 1), nk=(1, 2), max_radius=0.9).fit(record(true, 400, 6, 1.0))
    assert np.abs(model.poles).max() <= 0.9 + 1e-9


def test_bad_orders_and_data():
    data = record(OE_TRUE, 300, 8, 0.1)
    with pytest.raises(ParameterError, match="nb is 0"):
        Polynomial(nb=0)
    with pytest.raises(ParameterError, match="max_radius is 0"):
        Polynomial(max_radius=0)
    with pytest.raises(ParameterError, match="nf has 3 entries for the inputs u0, u1"):
        OutputError(nb=1, nf=(1, 1, 1)).fit(data)
    with pytest.raises(ParameterError, match="outputs y, u0; expected one"):
        OutputError(nb=1, nf=1).fit(data.select(inputs=["u1"], outputs=["y", "u0"]))
    with pytest.raises(ExcitationError, match=r"'u1'.*constant"):
        OutputError(nb=1, nf=1).fit(data.with_channel("u1", np.ones(300)))
    with pytest.raises(ExcitationError, match=r"the inputs u1 .* of u0 \(the correlation of u1 and u0 is \+1\)"):
        OutputError(nb=1, nf=1).fit(data.with_channel("u1", 2 * data["u0"]))
    with pytest.raises(TooShortError, match="20 samples for 12 parameters"):
        OutputError(nb=3, nf=3).fit(data.head(20))


@pytest.mark.parametrize(
    "estimator",
    [
        OutputError(nf=1, nb=1, max_radius=1),
        BoxJenkins(nf=1, nb=1, max_radius=1),
        StateSpace(order=1, max_radius=1),
        OutputError(nf=1, nb=1),
        BoxJenkins(nf=1, nb=1),
    ],
)
@pytest.mark.parametrize(("pole", "beyond"), [(0.98, False), (0.999, False), (1.005, True), (1.02, True)])
def test_a_pole_that_is_held_is_said_to_be(estimator, pole, beyond):
    rng = np.random.default_rng(3)
    u = rng.standard_normal(300)
    y = lfilter([0, 1], [1, -pole], u) + 0.01 * rng.standard_normal(300)
    data = Dataset.from_arrays({"u": u}, {"y": y}, 0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        model = estimator.fit(data)
    said = ["a pole ends at the limit of 1:" in s for s in model.fit_info.warnings]
    assert any(said) == (beyond and estimator.max_radius == 1)
    assert estimator.max_radius == 1 or model.poles == pytest.approx([pole], abs=1e-3)


def test_a_radius_beyond_one_that_an_f_cannot_have_is_refused():
    data = Dataset.from_arrays({"u": np.ones(50)}, {"y": np.arange(50.0)}, 0.1)
    with pytest.raises(ParameterError, match=r"max_radius is 1\.05; expected at most 1 with an F"):
        OutputError(nf=1, nb=1, max_radius=1.05).fit(data)


# ---- unstable systems ------------------------------------------------------------------------------------------------

FAST, SLOW = 1.1, 0.6  # poles


def held_by_a_controller(seed, *, colour=0.0, n=1500, level=0.0, inputs=1):
    """A system with a pole outside the unit circle under feedback, with white or coloured noise on its output."""
    rng = np.random.default_rng(seed)
    v = lfilter([1.0], [1.0, -colour], 0.3 * rng.standard_normal(n))
    r, (x, y), u = rng.standard_normal((n, inputs)), np.zeros((2, n)), np.zeros((n, inputs))
    _, a1, a2 = np.poly([FAST, SLOW])
    for k in range(n):
        if k > 1:
            x[k] = -a1 * x[k - 1] - a2 * x[k - 2] + u[k - 1] @ [1.0, 0.4][:inputs] + u[k - 2] @ [0.5, 0.0][:inputs]
        y[k] = x[k] + v[k]
        u[k] = r[k] - 0.35 * y[k] * np.eye(1, inputs)[0]
    names = [f"u{i}" for i in range(inputs)]
    return Dataset.from_arrays(dict(zip(names, u.T + 2 * level, strict=True)), {"y": y + level}, 0.1, name="held")


@pytest.mark.filterwarnings("ignore:the model is unstable")
@pytest.mark.parametrize("level", [0.0, 3.0])
@pytest.mark.parametrize(
    ("estimator", "colour"),
    [(OutputError(), 0.0), (BoxJenkins(), 0.0), (BoxJenkins(), 0.8)],
    ids=["OE", "BJ", "BJ, AR"],
)
def test_poles_outside_the_unit_circle_are_found_with_their_intervals(estimator, colour, level):
    """A is their part of F, and that of C is the same, mirrored (Forssell and Ljung, 2000)."""
    off = []
    for seed in range(6):
        model = replace(estimator, offset=bool(level)).fit(held_by_a_controller(seed, colour=colour, level=level))
        info = model.fit_info
        assert info.names[:4] == ("a1", "b1[u0]", "b2[u0]", "f1[u0]")
        off.append((info.values[:4] - [-FAST, 1.0, 0.5, -SLOW]) / info.std[:4])
        mirrored = np.roots(one(model.C))
        assert np.abs(mirrored + 1 / model.A[0]).min() < 1e-6
        again = model.with_estimates(info.values)
        assert again.poles == pytest.approx(model.poles)
    assert np.abs(off).max() < 4
    assert np.sqrt(np.mean(np.square(off))) < 1.5


@pytest.mark.filterwarnings("ignore:the model is unstable")
def test_the_predictor_of_an_unstable_output_error_model_is_that_of_the_paper():
    """Errors of one step are ``F_u / F_m (y - B / F u)``, by filters; eq. 12 with F = F_s F_u and F_m mirrored."""
    data = held_by_a_controller(3)
    model = OutputError().fit(data)
    outside, inside = one(model.A), one(model.F[0])
    mirrored = np.array([1.0, 1 / model.A[0]])
    y, u = data["y"], data["u0"]
    error = lfilter(outside, mirrored, y) - lfilter([0.0, *model.B[0]], np.convolve(inside, mirrored), u)
    run = model.predict(data)
    assert run.error[200:, 0] == pytest.approx(error[200:], abs=1e-6)
    assert np.std(error[200:]) == pytest.approx(0.3 * FAST, rel=0.06)


@pytest.mark.filterwarnings("ignore:the model is unstable")
def test_inputs_share_the_pole_outside():
    model = OutputError().fit(held_by_a_controller(0, inputs=2))
    assert np.sort(np.abs(model.poles)) == pytest.approx([SLOW, SLOW, FAST, FAST], abs=0.05)


@pytest.mark.parametrize("pole", [0.99, 1.0])
def test_no_pole_is_outside_of_a_stable_or_integrating_system(pole):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        u, e = rng.standard_normal((2, 1500))
        y = lfilter([0.0, 1.0, 0.3], np.poly([pole, 0.5]), u)
        data = Dataset.from_arrays({"u": u}, {"y": y + 0.1 * np.std(y) * e}, 0.1)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "a pole ends at the limit")
            assert not len(OutputError().fit(data).A)


def test_who_limits_the_poles_means_it():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        model = OutputError(max_radius=1.0).fit(held_by_a_controller(0))
    assert np.abs(model.poles).max() <= 1 + 1e-12
