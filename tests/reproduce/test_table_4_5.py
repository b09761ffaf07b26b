"""Table 4.5: black box, grey box and learned friction meet their bounds on data they were not fitted to."""

from dataclasses import replace

import pytest

from slipangle.data.public.sets import public
from slipangle.identify.judge.validate import score
from slipangle.reproduce import table_4_5


@pytest.fixture(scope="module")
def data(real_data):
    return table_4_5.with_velocity(public("emps"))


@pytest.mark.slow  # its state space is that of tests/identify/linear
def test_black_box(data):
    train, test = data.split(0.6)
    box = replace(table_4_5.black_box(), order=3)
    records = table_4_5._scores("", box.fit(train.select(outputs=["q", "v"])), test, {"q": 95.2, "v": 83.4}, "")
    assert [r.holds for r in records] == [True, None, True, None]


def test_grey_box(data):
    train, test = data.split(0.6)
    model = table_4_5._grey(train, "v")
    records = table_4_5._scores("", table_4_5._watching(model), test, {"q": 95.9, "v": 94.7}, "")
    assert [r.holds for r in records] == [True, None, True, None]
    assert model.params.mass == pytest.approx(94, abs=2)


@pytest.mark.slow
def test_learned_friction_on_the_official_test(data):
    pulses = table_4_5.with_velocity(public("emps-pulses"))
    model = table_4_5._learn(data, 0.014, 30.0)
    assert score(model.simulate(pulses), "q").rmse <= 2e-3


@pytest.mark.slow
@pytest.mark.usefixtures("real_data")
def test_reproduction_holds():
    result = table_4_5.reproduce(lambda share, what: None)
    assert result.holds
    assert sum(r.holds is True for r in result.records) == 5
