"""``slipangle robust``: batches, journal, page; the same results however they were computed."""

import json

import numpy as np
import pytest

from slipangle.cli import main
from slipangle.codegen.compiler import compiler
from slipangle.errors import ConfigError
from slipangle.workflow import robustness
from tests.simulate.test_robust import trial
from tests.workflow.test_cli import write_job

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler")


class Here:
    """A pool of one process: this one; it may stop after some batches."""

    def __init__(self, most=100):
        self.most, self.worked = most, []

    def work(self, objective, tasks):
        from slipangle.identify.search.pool import attempt

        for task in list(tasks)[: self.most]:
            self.worked.append(task.number)
            yield task.number, attempt(objective, task)
        if len(tasks) > self.most:
            raise KeyboardInterrupt

    def close(self):
        pass


def test_a_stopped_run_goes_on_and_has_the_same_results(tmp_path, monkeypatch):
    monkeypatch.setattr(robustness, "BATCH", 4)
    pools = [Here(), Here(most=1), Here(), Here()]
    used = iter(pools)
    monkeypatch.setattr(robustness, "Local", lambda workers: next(used))
    wanted = trial()
    whole = robustness.try_many(wanted, 10, tmp_path / "a", "mine")
    with pytest.raises(KeyboardInterrupt):
        robustness.try_many(wanted, 10, tmp_path / "b", "mine")
    with (tmp_path / "b").open("a") as file:
        file.write('{"batch": 1, "rows": [[1')  # cut off in the middle of a line
    again = robustness.try_many(wanted, 10, tmp_path / "b", "mine")
    assert pools[2].worked == [1, 2]
    assert np.array_equal(again.results, whole.results)
    assert np.array_equal(again.changes, whole.changes)
    assert len(robustness.try_many(wanted, 6, tmp_path / "b", "mine")) == 6  # all of it is kept
    more = robustness.try_many(wanted, 12, tmp_path / "b", "mine")
    assert pools[3].worked == [2]
    assert np.array_equal(more.results[:10], whole.results)
    with pytest.raises(ConfigError, match="another job, log or seed"):
        robustness.try_many(wanted, 10, tmp_path / "b", "yours")


@pytest.mark.slow
def test_processes_give_what_one_gives(tmp_path):
    wanted = trial()
    two = robustness.try_many(wanted, 60, tmp_path / "a", "mine", workers=2)
    one = robustness.try_on(wanted, range(60))
    assert np.array_equal(two.results, one.results)


def test_the_command_writes_a_page(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(robustness, "Local", lambda workers: Here())
    path = write_job(
        tmp_path,
        more="[controller]\nmodel = 'bicycle'\nv_x = 12.0\nhorizon = 10\n[plant]\ncatalogue = 'sousa-table-6.1'\n",
    )
    code = main(["robust", str(path), "--cars", "12", "--out", str(tmp_path / "out"), "--json"])
    said = json.loads(capsys.readouterr().out)
    assert code == (0 if said["share_inside"] >= 0.97 else 1)
    assert said["cars"] == 12
    assert set(said["worst"]["changes"]) == set(said["influence"])
    page = (tmp_path / "out" / "index.html").read_text()
    assert "What breaks it" in page
    assert "of 12 cars that differ from the model" in page
    assert main(["robust", str(write_job(tmp_path)), "--out", str(tmp_path / "out")]) == 2
    assert "has no [controller]" in capsys.readouterr().err
    assert main(["robust", str(path), "--cars", "0", "--out", str(tmp_path / "out")]) == 2
