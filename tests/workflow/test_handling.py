"""The section on handling: models beside the log by frequency, quantities over its speeds, nothing without a car."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

import slipangle as sa
from slipangle.report.style import INK, series_style
from slipangle.workflow.handling import _handling_section
from tests.models.all_models import ALL_MODELS
from tests.models.analysis.test_linearize import BICYCLE

N, DT = 3000, 0.02


def log(v_x=None, outputs=("r",)):
    rng = np.random.default_rng(0)
    delta = 0.02 * signal.lfilter(*signal.butter(2, 0.2), rng.standard_normal(N))
    v_x = np.linspace(15.0, 25.0, N) if v_x is None else v_x
    data = sa.Dataset.from_arrays(
        {"delta": delta, "v_x": v_x}, {n: np.zeros(N) for n in outputs}, DT, units={"delta": "rad", "v_x": "m/s"}
    )
    if "r" not in outputs:
        return data
    r = BICYCLE.resampled(DT, outputs=("r",)).simulate(data).y[:, 0]
    return data.with_channel("r", r + 0.003 * rng.standard_normal(N), "rad/s")


def section(models, data):
    validations = tuple(SimpleNamespace(name=n, model=m) for n, m in models.items())
    return list(_handling_section(SimpleNamespace(data=data, validations=validations), "run"))


def test_models_stand_beside_the_log():
    [found] = section({"car": BICYCLE, "ARX": ALL_MODELS["ARX"]}, log())
    table, over_speed, by_frequency = found.blocks
    assert table.title == "Handling of car at 72 km/h"
    drawn = over_speed.figure.data[0].x
    assert drawn[[0, -1]] == pytest.approx(3.6 * np.percentile(np.linspace(15, 25, N), [5, 95]), rel=1e-6)
    names = list(dict.fromkeys(t.name for t in by_frequency.figure.data if t.name))
    assert names == ["the log", "car"]  # the ARX model is sampled at another rate: below
    assert by_frequency.figure.layout.yaxis3.title.text == "coherence"


def test_at_one_speed_there_is_a_table_alone():
    [found] = section({"car": BICYCLE}, log(v_x=np.full(N, 20.0)))
    assert [type(b).__name__ for b in found.blocks] == ["Table", "Figure"]


def test_a_model_keeps_its_colour_and_the_log_is_as_measured():
    """Colours are those of the page's other figures, whoever is left out here."""
    models = {"tip": ALL_MODELS["single track, neural tires"], "car": BICYCLE, "soft": BICYCLE.with_values(C_f=5e4)}
    [found] = section(models, log())
    _, over_speed, by_frequency = found.blocks
    for figure in (over_speed.figure, by_frequency.figure):
        colours = {t.name: t.line.color for t in figure.data if t.name}
        for name in ("car", "soft"):
            assert colours[name] == series_style([*models].index(name))[0].light
    assert colours["the log"] == INK.light


def test_models_without_a_linear_answer_are_left_out():
    """A tire with a tip at zero slip has no linear model there; that costs the others nothing."""
    [found] = section({"tip": ALL_MODELS["single track, neural tires"], "car": BICYCLE}, log())
    assert found.blocks[0].title.startswith("Handling of car")


@pytest.mark.parametrize(
    "data", [log(outputs=("v_y",)), log(v_x=np.zeros(N), outputs=("v_y", "r"))], ids=["no r", "rest"]
)
def test_without_a_steered_car_there_is_no_section(data):
    assert section({"car": BICYCLE}, data) == []
