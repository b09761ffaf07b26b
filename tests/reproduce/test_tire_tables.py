"""Tables 4.4, 6.4, 6.8, 6.9: the data are what the notes say, and every bound is computed and holds."""

import numpy as np
import pytest

from slipangle.report.records import record_table
from slipangle.reproduce import find, names, table_4_4, table_6_4, table_6_8, table_6_9

QUIET = lambda share, words: None  # noqa: E731


def test_the_tables_can_be_found():
    assert {"table-4.4", "table-6.4", "table-6.8", "table-6.9"} <= set(names())
    assert find("table-6.4") is table_6_4


def test_data_of_table_6_4_have_the_spread_that_its_numbers_imply():
    """RMSE / sqrt(1 - R2) of the printed rows is the standard deviation of the data."""
    for (_, friction), column in zip(table_6_4.data(), (0, 2), strict=True):
        rows = [(float(p[column]), float(p[column + 1])) for p in table_6_4.PRINTED.values()]
        implied = [error / np.sqrt(1 - share) for share, error in rows if share < 0.5]
        assert np.std(friction) == pytest.approx(np.mean(implied), abs=5e-4)


def test_printed_digits_decide():
    measured = np.array([-1.0, 0.0, 1.0, 0.0])
    fitted = measured + np.array([0.0117, -0.0117, 0.0117, -0.0117])
    good = table_6_4.compare("row", "mu_x", ("0.9997", "0.0117"), measured, fitted)
    assert [r.holds for r in good] == [True, True]
    bad = table_6_4.compare("row", "mu_x", ("0.9999", "0.0116"), measured, fitted)
    assert [r.holds for r in bad] == [False, False]


def test_stand_ins_have_the_noise_they_say():
    for name, sigma in table_6_8.NOISE.items():
        slip, friction, noise = table_6_8.stand_in(name)
        assert np.std(noise) == pytest.approx(sigma, rel=0.1)
        assert friction - noise == pytest.approx(table_6_8.PRINTED[name](slip))
        assert slip.min() == pytest.approx(-slip.max())
    assert [len(table_6_8.stand_in(n)[0]) for n in table_6_8.NOISE] == [322, 1268]
    angle, _, noise = table_4_4.stand_in()
    peak = angle[np.argmax(table_4_4.TRUTH(angle))]
    assert np.rad2deg(peak) == pytest.approx(5.0, abs=0.3)
    assert np.std(noise) == pytest.approx(0.02, rel=0.15)


def test_table_4_4():
    result = table_4_4.reproduce(QUIET)
    assert len(result.records) == 4
    assert result.holds, record_table(result.records).to_text()


@pytest.mark.parametrize("label", ["RBF {5}", "MLP {1 1 1}", "MLP {2 2}"])
def test_rows_of_table_6_4(label):
    printed = table_6_4.PRINTED[label]
    for k, (slip, friction) in enumerate(table_6_4.data()):
        curve = table_6_4.settings(label).fit(slip, friction)
        records = table_6_4.compare(label, "mu", printed[2 * k : 2 * k + 2], friction, curve(slip))
        assert all(r.holds for r in records), record_table(records).to_text()


def test_tangent_reproduces_the_printed_digits_of_three_single_neurons():
    """What settles that the thesis' sigmoid is the hyperbolic tangent: the optimum is the printed one."""
    for (slip, friction), printed in zip(table_6_4.data(), ("0.1040", "0.0276"), strict=True):
        curve = table_6_4.settings("MLP {1 1 1}").fit(slip, friction)
        assert f"{np.sqrt(np.mean((curve(slip) - friction) ** 2)):.4f}" == printed


@pytest.mark.slow
@pytest.mark.parametrize("module", [table_6_4, table_6_8, table_6_9], ids=lambda m: m.__name__[-9:])
def test_whole_tables(module):
    result = module.reproduce(QUIET)
    assert result.holds, record_table(result.records).to_text()
