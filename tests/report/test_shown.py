"""Results show themselves: a line that fits a terminal, a table for a notebook, a figure of the right channel."""

import math
from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ParameterError
from slipangle.identify.car.identify_car import IdentifiedCar
from slipangle.identify.search.search import SearchResult, TrialResult
from slipangle.models.model import ProfileInfo
from slipangle.report import Heading, Row, Table
from slipangle.report.drawn import figure
from slipangle.report.shown import table
from slipangle.simulate.run import End, Run
from slipangle.simulate.trials import Trials
from tests.models.all_models import ALL_MODELS
from tests.report.example import fit_info

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler was found")
PARAMS = sa.BicycleParams(mass=1500, inertia_z=2500, wheelbase=2.7, l_f=1.2, C_f=9e4, C_r=1.1e5)
CAR = sa.Bicycle(params=PARAMS, dt=0.02)


def controller():
    return sa.MPC(sa.OnGround(CAR), horizon=5, controls=("delta",), Q=sa.Weights(Y=1.0), S=sa.Weights(delta=1.0))


def log(n=400):
    t = 0.02 * np.arange(n)
    delta, v_x = 0.02 * np.sin(2 * np.pi * 0.5 * t), np.full(n, 20.0) + 0.1 * np.sin(t)
    zero = sa.Dataset.from_arrays(
        {"delta": delta, "v_x": v_x}, {"r": np.zeros(n)}, 0.02, units={"delta": "rad", "v_x": "m/s", "r": "rad/s"}
    )
    r = CAR.simulate(zero).y[:, 0]
    return zero.with_channel("r", r + 1e-3 * np.cos(9 * t), "rad/s")


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    data, rng = log(), np.random.default_rng(0)
    path = sa.double_lane_change(20.0)
    n = len(path.s)
    rows = {"v_x": np.full(n, 20.0), "X": path.X, "Y": path.Y, "psi": path.psi}
    states = np.column_stack([*rows.values()])
    zeros = np.zeros(n)
    run = Run(
        t=path.s / 20.0, state_names=tuple(rows), states=states, input_names=("delta",), inputs=0.1 + zeros[:, None],
        path=path, width=1.8, s=path.s, reference=np.column_stack([path.X, path.Y, path.psi, rows["v_x"]]), e_y=zeros,
        e_psi=zeros, v_x=rows["v_x"], plans=(), t_plan=np.zeros(0), controls=("delta",), end=End.FINISHED,
    )  # fmt: skip
    mpc = controller()
    rich = data.with_channel("delta", 0.02 * rng.standard_normal(400), "rad").select(inputs=["delta"], outputs=["r"])
    rich = rich.with_channel("r", np.convolve(rich["delta"], 0.5 ** np.arange(20))[:400], "rad/s")
    spiked = data.with_channel("r", np.where(np.arange(400) == 200, 5.0, data["r"]), "rad/s")
    done = [TrialResult(number=k, settings={"na": k, "nb": 2}, score=1.0 / (k + 1), seconds=0.1) for k in range(4)]
    names = ("mass", "delay")
    rows = rng.uniform(size=(32, 2)), (rng.uniform(size=(32, 5)) > 0.3).astype(float)
    return {
        "plan": mpc.plan(np.zeros(mpc.model.n_states), mpc.reference(path.ahead(0.0, mpc.times))),
        "folds": sa.cross_validate(sa.ARX(na=1, nb=1), sa.join(data.head(200), data.head(200)), folds=2),
        "orders": sa.StateSpace(order=(1, 2)).choose_order(rich),
        "advice": sa.advise(sa.GreyBox(start=CAR, free=("C_f",)).fit(data), data)[0],
        "inspected": sa.inspect(spiked),
        "log": sa.open_log(sa.write(data, tmp_path_factory.mktemp("logs") / "log.csv")),
        "search": SearchResult(trials=tuple(done)),
        "cars": Trials(names=names, changes=rows[0], results=rows[1]),
        "data": data,
        "trajectory": CAR.simulate(data),
        "fit": fit_info(),
        "verdict": sa.validate(CAR, data, name="car"),
        "comparison": sa.compare({"car": CAR, "other": CAR.with_values(C_f=6e4)}, data),
        "run": run,
        "path": path,
        "car": IdentifiedCar(model=_fitted(), stages=(), doubts=(), sentences=("it fits",), separated={}),
    }


def _fitted():
    return replace(CAR, fit_info=fit_info())


RESULTS = ["data", "trajectory", "fit", "verdict", "comparison", "run", "path", "car", "plan", "folds", "orders"]
EVERY = pytest.mark.parametrize("name", [*RESULTS, "advice", "inspected", "log", "search", "cars"])


@EVERY
def test_a_line_fits_a_terminal(results, name):
    said = repr(results[name])
    assert said.startswith(f"<{type(results[name]).__name__}: ")
    assert "\n" not in said
    assert len(said) < 250


@EVERY
def test_a_notebook_gets_a_table(results, name):
    text = results[name]._repr_html_()
    assert text.count("<table>") == 1
    assert "nan" not in text


@EVERY
def test_each_has_a_figure(results, name):
    assert len(results[name].plot().data) > 0


PUBLIC = {name: getattr(sa, name) for name in sa.__all__ if isinstance(getattr(sa, name), type)}


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_object_has_a_line_and_a_table(name):
    """None has that of `object`, or the one that `dataclass` writes of everything that it holds."""
    kind = PUBLIC[name]
    assert kind.__repr__ is not object.__repr__
    assert not hasattr(kind.__repr__, "__wrapped__")  # as that of `dataclass` is
    assert callable(kind._repr_html_)


@pytest.mark.parametrize("name", ALL_MODELS)
def test_a_model_says_itself_in_a_short_line(name):
    said = repr(ALL_MODELS[name])
    assert len(said) <= 160
    assert "\n" not in said
    assert said.startswith(f"{type(ALL_MODELS[name]).__name__}(")
    assert ALL_MODELS[name]._repr_html_().count("<table>") == 1


def test_a_line_has_what_is_not_as_by_default():
    assert repr(PARAMS) == "BicycleParams(mass=1500, inertia_z=2500, wheelbase=2.7, l_f=1.2, C_f=90000, C_r=110000)"
    assert repr(sa.ARX(na=2, nb=3)) == "ARX(na=2, nb=3, nk=1)"
    assert repr(sa.Limits(delta=0.3)) == "Limits(delta=(-0.3, 0.3))"
    assert repr(sa.TerminalCost(("Y", "v_y"), np.eye(2))) == "TerminalCost(names=('Y', 'v_y'), matrix=array 2 x 2)"
    assert repr(sa.Channel("r", "rad/s")) == "Channel(name='r', unit='rad/s')"
    many = sa.Weights({f"q{k}": float(k) for k in range(40)})
    assert repr(many).endswith(", ...)")
    assert len(repr(many)) <= 160
    mpc = controller()
    assert repr(mpc).startswith("MPC(model=OnGround(model=Bicycle(params=BicycleParams(mass=1500, ")
    assert len(repr(mpc)) <= 160


def test_settings_show_values_units_and_meanings():
    text = PARAMS._repr_html_()
    assert ">90000<" in text
    assert "N/rad" in text
    assert "Yaw moment of inertia" in text
    for thing, names in ((sa.NARX(na=1, nb=1), ("hidden", "na")), (controller(), ("horizon", "Q", "deadline"))):
        said = {row.cells[0]: row.cells[-1] for row in table(thing).rows}
        assert all(said[name] for name in names), said


def test_what_is_seen_in_a_log_is_drawn_at_its_time(results):
    drawn = results["inspected"].plot()
    assert [(t.name, *t.x) for t in drawn.data] == [("spike", pytest.approx(4.0))]


def test_every_fold_has_a_bar_of_its_own(results):
    drawn = results["folds"].plot()
    assert len(set(drawn.data[0].x)) == len(results["folds"].folds) == 2
    assert np.asarray(drawn.data[0].y) == pytest.approx(results["folds"].fit("r"))


def test_a_log_has_a_panel_for_each_channel(results):
    drawn = results["log"].plot("v_x", "r")
    assert [t.yaxis for t in drawn.data] == ["y", "y2"]
    assert drawn.layout.yaxis2.title.text == "r [rad/s]"


def test_no_line_is_drawn_where_a_log_has_no_samples(tmp_path):
    """A stop of 4 s and a channel's empty cells are holes in its line, cells that stand are joined."""
    t = np.concatenate([np.arange(0, 5, 0.01), np.arange(9, 12, 0.01)])
    x = [f"{np.sin(v):.6f}" for v in t]
    x[100:130] = [""] * 30
    rows = "".join(f"{v:.2f},{v:.2f},{w}\n" for v, w in zip(t, x, strict=True))
    (tmp_path / "stops.csv").write_text("time [s],<b>a,x [m]\n" + rows)
    drawn = sa.open_log(tmp_path / "stops.csv").plot("<b>a", "x")
    assert [trace.name for trace in drawn.data] == ["&lt;b&gt;a", "x"]
    for trace, holes in zip(drawn.data, ([(4.99, 9.0)], [(0.99, 1.3), (4.99, 9.0)]), strict=True):
        when, value = np.asarray(trace.x, dtype=float), np.asarray(trace.y, dtype=float)
        empty = np.flatnonzero(np.isnan(value))
        assert [(when[k - 1], when[k + 1]) for k in empty] == [pytest.approx(hole, abs=1e-9) for hole in holes]
        joined = np.diff(when)[np.isfinite(value[1:]) & np.isfinite(value[:-1])]
        assert joined.max() < 0.011


def test_a_figure_says_what_it_leaves_out(tmp_path):
    names = [f"c{k}" for k in range(9)]
    rows = "".join(f"{0.1 * k:.1f}{f',{k}' * 9}\n" for k in range(20))
    (tmp_path / "wide.csv").write_text(f"time [s],{','.join(names)}\n{rows}")
    recording = sa.open_log(tmp_path / "wide.csv")
    assert "6 of 10 channels" in recording.plot().layout.xaxis6.title.text
    assert recording.plot("c1", "c2").layout.xaxis2.title.text == "time [s]"


def test_nothing_seen_in_a_log_is_said(results):
    assert sa.inspect(results["data"]).plot().layout.annotations[0].text == "no spikes, jumps or standstills"
    assert not results["inspected"].plot().layout.annotations


def test_a_plan_is_drawn_as_it_is_held(results):
    plan = results["plan"]
    drawn = plan.plot("delta").data[0]
    assert drawn.line.shape == "hv"
    assert np.asarray(drawn.y)[: len(plan.u)] == pytest.approx(np.degrees(plan.u[:, 0]), abs=1e-4)
    assert "ms" in repr(plan)


def test_lines_say_the_numbers(results):
    assert "9.00" not in repr(results["fit"])
    assert repr(results["data"]) == "<Dataset: 400 samples of delta, v_x, r at 50 Hz, 8 s>"
    fit = sa.validate(CAR, results["data"], name="car").free_run_scores["r"].fit
    assert repr(results["verdict"]) == f"<Validation: car fits {fit:.1f} % of r>"
    assert f"the best of 2 on data is car, {fit:.1f} % of r" in repr(results["comparison"])
    assert "inside its lanes, 0 m (RMS)" in repr(results["run"])


def test_a_fit_says_its_own_intervals_not_those_of_the_covariance():
    info = ProfileInfo(
        names=("C_f",), values=np.array([1.0]), covariance=np.eye(1), noise_std=np.ones(1), n_samples=9,
        limits=np.array([[0.75, 1.25]]),
    )  # fmt: skip
    assert repr(info) == "<ProfileInfo: C_f = 1 ± 0.25; 0 warnings>"


def test_channels_are_drawn_in_degrees_and_kilometres_an_hour(results):
    data = results["data"]
    drawn = data.plot("delta", "v_x")
    assert [t.name for t in drawn.data] == ["delta", "v_x"]
    assert drawn.data[0].y == pytest.approx(np.degrees(data["delta"]), rel=1e-5, abs=1e-6)
    assert drawn.data[1].y == pytest.approx(3.6 * data["v_x"], rel=1e-5)
    assert "[deg]" in drawn.layout.yaxis.title.text
    free = results["verdict"].plot("r")
    assert free.data[0].y == pytest.approx(np.degrees(data["r"]), rel=1e-5, abs=1e-5)
    over_time = results["run"].plot("delta")
    assert over_time.data[0].y == pytest.approx(np.full(len(results["run"].t), np.degrees(0.1)), rel=1e-5)


def test_an_output_has_the_unit_of_the_data_not_that_of_its_name():
    """An r in metres is drawn and told in metres, what the nomenclature has not in its own unit."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(300)
    y = np.convolve(u, 0.5 ** np.arange(20))[:300] + 0.1 * rng.standard_normal(300)
    data = sa.Dataset.from_arrays(
        {"u": u}, {"r": y, "U": rng.standard_normal(300) - y}, 0.02, units={"r": "m", "U": "V"}
    )
    train, test = data.split(0.5)
    model = sa.ARX(na=1, nb=1).fit(train)
    verdict, ranking, run = sa.validate(model, test), sa.compare({"a": model}, test), model.simulate(test)
    folds = sa.cross_validate(sa.ARX(na=1, nb=1), data, folds=2)
    for result in (verdict, ranking, run):
        drawn = result.plot("r")
        assert drawn.layout.yaxis.title.text.endswith("[m]")
        assert np.asarray(drawn.data[0].y, dtype=float) == pytest.approx(test["r"], rel=1e-5, abs=1e-6)
        assert result.plot("U").layout.yaxis.title.text.endswith("[V]")
    for result in (verdict, ranking, folds):
        assert {row[-1].split()[1] for row in table(result).texts()} == {"m", "V"}
    assert [row[2] for row in table(run).texts()] == ["m", "V"]


def test_a_runs_solver_time_leaves_out_the_cold_first_step(results):
    """As page and metrics do: one slow step of 31 at the start is not the 99th percentile."""
    plan = results["plan"]
    plans = tuple(replace(plan, seconds=1.0 if k == 0 else 0.001) for k in range(31))
    run = replace(results["run"], plans=plans, t_plan=np.zeros(31))
    told = {row.cells[0]: row.cells[1] for row in table(run).rows}
    assert told["solver, 99th percentile"] == pytest.approx(1.0)
    assert len(run.warm_seconds) == 30
    assert replace(run, plans=plans[:1]).warm_seconds.tolist() == [1.0]


def test_advice_has_units(results):
    """Widths are read as parameters are: an offset in degrees, stiffness in N/rad."""
    advice = replace(
        results["advice"],
        names=("C_f", "steering_offset"),
        units=("N/rad", "rad"),
        present=np.array([9e3, 0.02]),
        std=np.array([3e3, 0.01]),
    )
    assert table(results["advice"]).rows[0].cells[3] == "N/rad"
    assert [row.cells[1:] for row in table(advice).rows] == [
        (9e3, 3e3, "N/rad"),
        (pytest.approx(math.degrees(0.02)), pytest.approx(math.degrees(0.01)), "deg"),
    ]


def test_scores_are_read_in_degrees_as_figures_are(results):
    told = table(results["verdict"])
    assert told.columns[-1].heading == "RMSE [deg/s]"
    assert told.rows[0].cells[-1] == pytest.approx(np.degrees(results["verdict"].free_run_scores["r"].rmse))
    with sa.units.shown_in_si():
        assert table(results["verdict"]).columns[-1].heading == "RMSE [rad/s]"


@pytest.mark.parametrize(
    ("name", "asked", "said"),
    [
        ("data", ("rr",), "no channel 'rr'; nearest are 'r'"),
        ("verdict", ("v_y",), "no output 'v_y'"),
        ("verdict", ("r", "r"), "2 outputs for one figure; expected one of r"),
        ("path", ("X",), "no channel of a path 'X'"),
        ("run", ("yaw",), "the run has no channel 'yaw'"),
        ("run", (["X", "Y"],), r"plot\(\) was given \('X', 'Y'\) for a name; expected strings one by one"),
        ("data", (3,), r"plot\(\) was given 3 for a name"),
        ("plan", (None,), r"plot\(\) was given None for a name"),
    ],
)
def test_names_that_are_not_there_get_a_sentence(results, name, asked, said):
    with pytest.raises(ParameterError, match=said):
        results[name].plot(*asked)


def test_other_things_are_refused():
    with pytest.raises(ParameterError, match="a str has no table"):
        table("text")
    with pytest.raises(ParameterError, match="a str has no figure"):
        figure("text", ())


def test_a_model_shows_its_parameters():
    assert "81 200" in _fitted()._repr_html_()
    text = CAR._repr_html_()
    assert "110 000" in text
    assert "kg m²" in text
    assert "delta, v_x" in text


def test_a_table_is_latex_and_markdown():
    made = Table(
        title="A_b",
        columns=(Heading("name", words=True), Heading("gain", "m/s2", 3)),
        rows=(Row(("C_f | x", 81200.0)), Row(("± 5 %", None))),
        caption="50 % & more.",
    )
    assert made.to_markdown().splitlines() == [
        "**A_b**", "", "| name | gain [m/s²] |", "| :-- | --: |", "| C_f \\| x | 81 200 |", "| ± 5 % | – |", "",
        "50 % & more.",
    ]  # fmt: skip
    assert made.to_latex().splitlines() == [
        r"\begin{table}", r"\centering", r"\begin{tabular}{lr}", r"\toprule",
        r"name & gain [m/s\textsuperscript{2}] \\", r"\midrule", r"C\_f | x & 81\,200 \\", r"$\pm$ 5 \% & -- \\",
        r"\bottomrule", r"\end{tabular}", r"\caption{A\_b. 50 \% \& more.}", r"\end{table}",
    ]  # fmt: skip
    assert made._repr_html_().startswith("<b>A_b</b>")
