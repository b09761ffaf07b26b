"""The page of a comparison says first which model is best, by how much, and of how many parameters each is."""

import re
from dataclasses import replace

import numpy as np
from scipy import signal

import slipangle as sa
from slipangle.report import Table, Verdict
from tests.models.analysis.test_linearize import BICYCLE, fitted


def page(**models):
    n = 400
    rng = np.random.default_rng(0)
    zero = sa.Dataset.from_arrays(
        {"delta": 0.02 * np.sin(0.06 * np.arange(n)), "v_x": np.full(n, 20.0)}, {"r": np.zeros(n)}, 0.02,
        units={"delta": "rad", "v_x": "m/s"},
    )  # fmt: skip
    car = replace(BICYCLE, outputs=("r",))
    data = zero.with_channel("r", car.simulate(zero).y[:, 0] + 0.002 * rng.standard_normal(n), "rad/s")
    shown = {"soft": car.with_values(C_f=5e4), "true": replace(fitted()[0], outputs=("r",)), **models}
    result = sa.compare(shown, data)
    return result, sa.comparison_page(result, data, command="slipangle compare a b")


def test_the_best_stands_first_with_its_margin():
    result, made = page()
    table, verdict = made.sections[0].blocks
    assert isinstance(table, Table)
    assert isinstance(verdict, Verdict)
    assert [r.cells[0] for r in table.rows] == ["true", "soft"]
    assert table.rows[0].cells[2] == result.best.scores["r"].fit
    assert table.rows[0].cells[5] == 2
    assert table.rows[1].cells[5] is None
    rmse = float(table.rows[0].cells[4].split()[0])
    assert abs(rmse - np.degrees(result.best.scores["r"].rmse)) < 0.005 * rmse
    ranking = made.sections[1].blocks[0]  # in the unit of the table above it
    assert ranking.texts()[0][-1] == table.rows[0].cells[4].split()[0]
    assert "deg/s" in ranking.to_text()
    share = 100 * (1 - result.entries[0].error / result.entries[1].error)
    assert f"{share:.0f} % smaller than that of “soft”" in verdict.sentence
    assert {r.tone for r in table.rows} == {verdict.tone, None}  # one judgement in table and sentence
    text = made.to_html()
    assert re.search(r'<a href="#output-r">output r</a>', text)
    assert made.title == "2 models on data"


def test_a_fair_verdict_says_why():
    info = replace(fitted()[0].fit_info, warnings=("something is doubtful",))
    _, made = page(true=replace(fitted()[0], outputs=("r",), fit_info=info))
    table, verdict = made.sections[0].blocks
    assert (verdict.tone, table.rows[0].tone) == ("fair", "fair")
    assert verdict.sentence.endswith("1 warning on it stands below.")


def driven(n, seed, poles=()):
    """A drive with a yaw rate of four times the steering, through a system with these poles, and hardly any noise."""
    rng = np.random.default_rng(seed)
    delta = signal.lfilter([0.2], [1.0, -0.8], 0.05 * rng.standard_normal(n))
    past = np.atleast_1d(np.poly(poles))
    r = signal.lfilter([4.0 * past.sum()], past, delta) + 2e-4 * rng.standard_normal(n)
    v_x = 20 + 0.01 * rng.standard_normal(n)
    return sa.Dataset.from_arrays({"delta": delta, "v_x": v_x}, {"r": r}, 0.02)


def judged(train, test, model):
    model = replace(model, fit_info=replace(model.fit_info, warnings=()))
    result = sa.compare({"only": model}, test, on_training_data=True)
    table, verdict = sa.comparison_page(result, test, train=train).sections[0].blocks
    alone = sa.comparison_page(result, test).sections[0].blocks[1]
    assert alone.tone == "fair"
    assert "No simple model stands beside it" in alone.sentence
    assert table.rows[0].tone == verdict.tone
    return result.best.scores["r"].fit, verdict


def test_the_best_of_bad_models_is_not_called_good():
    """A model that explains half where a straight line explains 98 % is poor though it is the best of its table."""
    train, test = driven(1500, 0), driven(1000, 1)
    halved = train.with_channel("r", 0.5 * train["r"], "rad/s")
    fit, verdict = judged(train, test, sa.ARX(na=1, nb=1, nk=0).fit(halved))
    assert 45 < fit < 55
    gain = np.linalg.lstsq(train.u[:, :1], train.y, rcond=None)[0]
    assert np.std(test.y - test.u[:, :1] @ gain) < 0.02 * np.std(test.y)
    assert verdict.tone == "poor"
    assert "times that of the simple model" in verdict.sentence


def test_the_best_is_good_where_no_simple_model_follows():
    swinging = 0.97 * np.exp(0.3j), 0.97 * np.exp(-0.3j)
    train, test = driven(1500, 0, swinging), driven(1000, 1, swinging)
    fit, verdict = judged(train, test, sa.OutputError(nb=1, nf=2, nk=0).fit(train))
    assert fit > 95
    assert verdict.tone == "good"


def test_figure_and_table_judge_the_same_samples():
    """Models that begin at other samples are judged where all predict; the error's cloud says the table's RMSE."""
    train, test = driven(800, 0), driven(60, 1)
    rough = test.with_channel("r", np.where(np.arange(60) < 12, 5 * test["r"], test["r"]), "rad/s")
    models = {"short": sa.ARX(na=1, nb=1, nk=0).fit(train), "long": sa.ARX(na=1, nb=1, nk=12).fit(train)}
    result = sa.compare(models, rough)
    ranking, _, cloud, _ = sa.comparison_page(result, rough).sections[1].blocks
    said = {row[0]: row[-1] for row in ranking.texts()}
    drawn = {re.sub("<.*?>|,.*", "", a.text): a.text.split("RMSE ")[1] for a in cloud.figure.layout.annotations}
    assert {n: f"{said[n]} deg/s" for n in models} == drawn
