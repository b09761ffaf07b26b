"""Table 4.1: every printed value, and the structure that cross-validation chooses."""

import pytest

from slipangle.data.public.sets import public
from slipangle.identify.linear.arx import ARX
from slipangle.reproduce import find, table_4_1


@pytest.mark.usefixtures("real_data")
def test_all_32_printed_values():
    train, test = public("robot-arm").split(0.85)
    assert (train.n_samples, test.n_samples) == (870, 154)
    records = []
    for key, printed in table_4_1.PRINTED.items():
        model = ARX(na=key[1], nb=key[2]).fit(train)
        records += table_4_1._entries(key, printed, model, train, test)
    assert len(records) == 32
    assert all(r.holds for r in records), [r for r in records if not r.holds]
    cut = [r for r in records if r.note and r.quantity.startswith(("estimation RMSE", "validation RMSE"))]
    assert {r.bound for r in cut} == {f"{x}, rounded or cut" for x in ("5.44", "5.33", "3.83", "179")}


@pytest.mark.usefixtures("real_data")
@pytest.mark.parametrize(
    "printed",
    [("5.46", "0.999", "3.77", "0.999"), ("5.44", "0.998", "3.77", "0.999"), ("5.44", "0.999", "3.79", "0.999")],
)
def test_a_wrong_digit_is_noticed(printed):
    train, test = public("robot-arm").split(0.85)
    model = ARX(na=4, nb=8).fit(train)
    records = table_4_1._entries(("OSA", 4, 8), printed, model, train, test)
    assert [r.holds for r in records].count(False) == 1


def test_candidates_go_from_simple_to_complex():
    assert find("table-4.1") is table_4_1
    names = list(table_4_1.candidates())
    assert names[0] == "linear, order 4"
    assert len(names) == len(set(names)) == 6


@pytest.mark.usefixtures("real_data")
def test_the_chosen_structure_beats_the_bound():
    train, test = public("robot-arm").split(0.85)
    chosen = table_4_1.candidates()["order 6, 1 hardening branch"]
    model = table_4_1._fit(chosen, train)
    assert 1e4 * table_4_1._score(model, test).rmse <= table_4_1.BOUND


@pytest.mark.slow
@pytest.mark.usefixtures("real_data")
def test_reproduction_holds():
    result = table_4_1.reproduce(lambda share, what: None)
    assert result.holds
    assert "hardening" in result.records[-2].note
