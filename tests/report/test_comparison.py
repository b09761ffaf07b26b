"""The page of a comparison says first which model is best, by how much, and of how many parameters each is."""

import re
from dataclasses import replace

import numpy as np

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
