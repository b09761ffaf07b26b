"""The search: same trials whoever computes them, nothing lost when it stops, failures kept with their reason."""

import os
import signal
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest

from slipangle.errors import ConfigError, ParameterError
from slipangle.identify.networks.problem import Stage
from slipangle.identify.search.narx import STAGES, THESIS, WIDER, NarxObjective
from slipangle.identify.search.pool import Local, Task, attempt
from slipangle.identify.search.search import Choice, Range, Search, SearchResult, TrialResult, columns
from tests.identify.networks.test_hybrid import nonlinear_response

SPACE = {"na": Range(low=1, high=8), "rate": Range(low=1e-4, high=1e-1, log=True), "act": Choice(values=("a", "b"))}


def bowl(settings, seed, report=None):
    return (settings["na"] - 5) ** 2 + abs(settings["rate"] - 0.01) + (settings["act"] == "b") + 1e-9 * seed


def picky(settings, seed, report):
    if settings["act"] == "b":
        raise RuntimeError("b is bad")
    return bowl(settings, seed)


def deadly(settings, seed, report):
    if seed == 2:
        os._exit(3)
    return bowl(settings, seed)


def stopped(settings, seed, report):
    os.kill(os.getpid(), signal.SIGINT)
    return 0.0


@pytest.fixture
def optuna():
    return pytest.importorskip("optuna")


def quick(**kwargs):
    return Search(**{"space": SPACE, "trials": 8, "round_size": 4, "workers": 2, **kwargs})


def plain(result):
    return [(t.number, t.settings, t.score, t.failure) for t in result.trials]


def test_an_interrupt_ends_a_worker_without_a_word(capfd):
    """A terminal sends it to all processes; who waits for them says what there is to say."""
    pool = Local(1)
    [(_, done)] = pool.work(stopped, [Task(number=0, settings={}, seed=0)])
    pool.close()
    assert done["failure"] == "its process died twice"
    assert "KeyboardInterrupt" not in capfd.readouterr().err


def test_workers_do_not_change_the_trials(optuna):
    one, two = quick(workers=1).run(bowl), quick(workers=2).run(bowl)
    assert plain(one) == plain(two)
    assert [t.number for t in one.trials] == list(range(8))
    assert one.best.score == min(t.score for t in one.trials)
    assert plain(quick(seed=1).run(bowl)) != plain(one)


def test_a_study_goes_on_where_it_stopped(optuna, tmp_path):
    whole = quick().run(bowl)
    journal = tmp_path / "study.journal"
    assert len(quick(trials=3, journal=journal).run(bowl).trials) == 3  # stops in mid-round
    told = []
    rest = quick(journal=journal).run(bowl, progress=lambda share, what: told.append(share))
    assert plain(rest) == plain(whole)
    assert len(told) == 5
    assert told == sorted(told)
    assert plain(quick(journal=journal).run(picky)) == plain(whole)  # all done: nothing is computed again


def test_failed_trials_stay_with_their_reason(optuna, tmp_path):
    result = quick(trials=8, journal=tmp_path / "j").run(picky)
    assert result.failed
    assert {t.failure for t in result.failed} == {"RuntimeError: b is bad"}
    assert {t.settings["act"] for t in result.failed} == {"b"}
    assert result.best.settings["act"] == "a"
    again = quick(trials=8, journal=tmp_path / "j").run(bowl)
    assert plain(again) == plain(result)


def test_a_process_that_dies_costs_its_own_trial_only(optuna):
    result = quick(trials=4).run(deadly)
    assert [t.number for t in result.trials] == [0, 1, 2, 3]
    assert [bool(t.failure) for t in result.trials] == [False, False, True, False]
    assert result.trials[2].failure == "its process died twice"


def test_another_search_does_not_continue_a_journal(optuna, tmp_path):
    quick(trials=1, journal=tmp_path / "j").run(bowl)
    with pytest.raises(ConfigError, match="another search"):
        quick(trials=2, seed=5, journal=tmp_path / "j").run(bowl)


@dataclass(frozen=True)
class Bowl:
    signature: str

    def __call__(self, settings, seed, report):
        return bowl(settings, seed)


def test_a_journal_is_of_one_log_and_training(optuna, tmp_path):
    quick(trials=1, journal=tmp_path / "j").run(Bowl("a"))
    quick(trials=1, journal=tmp_path / "j").run(Bowl("a"))
    with pytest.raises(ConfigError, match="another search"):
        quick(trials=1, journal=tmp_path / "j").run(Bowl("b"))


def test_what_is_searched_for_is_the_data_and_the_training():
    data = nonlinear_response(100)
    own = NarxObjective(data=data).signature
    assert NarxObjective(data=replace(data, name="renamed")).signature == own
    other = data.values.copy()
    other[50, -1] = np.nextafter(other[50, -1], np.inf)
    longer = (replace(STAGES[0], epochs=STAGES[0].epochs + 1), *STAGES[1:])
    changed = [{"data": replace(data, values=other)}, {"stages": longer}, {"shares": (0.5, 1.0)}]
    assert all(NarxObjective(**{"data": data} | change).signature != own for change in changed)


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_a_seed_is_what_generators_take(seed):
    with pytest.raises(ParameterError, match="seed is"):
        quick(seed=seed)


def test_without_the_extra_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(ConfigError, match=r"slipangle\[cluster\]"):
        quick().run(bowl)


def slow_learner(settings, seed, report):
    """Reports three times; what it says at first is what it says at last, times two."""
    score = bowl(settings, seed)
    for k in (3, 2, 1):
        report(k * score)
    return score


def test_bad_trials_are_given_up_alike_whoever_computes_them(optuna, tmp_path):
    settings = {"trials": 16, "sampler": "random"}
    one, two = quick(workers=1, **settings).run(slow_learner), quick(workers=2, **settings).run(slow_learner)
    assert plain(one) == plain(two)
    assert one.pruned
    assert not one.failed
    assert all(t.number >= 4 and len(t.steps) < 3 for t in one.pruned)  # the first round has nothing to be worse than
    assert "where the median of earlier trials was" in one.pruned[0].failure
    every = quick(pruner="none", **settings).run(slow_learner)
    assert not every.pruned
    assert every.best.score == one.best.score
    half = quick(journal=tmp_path / "j", **{**settings, "trials": 7}).run(slow_learner)
    assert len(half.trials) == 7
    assert plain(quick(journal=tmp_path / "j", **settings).run(slow_learner)) == plain(one)


def test_attempt_never_raises():
    def one(objective):
        return attempt(objective, Task(number=0, seed=0, settings={}))

    assert one(lambda s, seed, report: 1 / 0)["failure"] == "ZeroDivisionError: division by zero"
    assert one(lambda s, seed, report: float("nan"))["failure"] == "the score is nan"
    assert one(lambda s, seed, report: 2.0)["score"] == 2.0


# ---- networks ------------------------------------------------------------------------------------------------------


def test_narx_objective_is_the_free_run_error_on_later_stretches():
    data = nonlinear_response(700)
    objective = NarxObjective(data=data, stages=(Stage(horizon=1, epochs=30, learning_rate=1e-2),), shares=(0.7, 1.0))
    settings = {"na": 2, "nb": 2, "layers": 1, "neurons": 4, "activation": "tanh", "learning_rate": 5e-3}
    told = []
    score = objective(settings, 3, told.append)
    assert told == [score]
    assert objective.estimator(settings, 3).seeds == (3,)
    assert objective.estimator(settings, 3).stages[0].learning_rate == 5e-3
    run = objective.estimator(settings, 3).fit(data.rows(0, 490)).simulate(data.rows(490, 700))
    expected = np.sqrt(np.mean(run.error[run.predicted] ** 2)) / np.std(run.measured[run.predicted])
    assert score == pytest.approx(expected, rel=1e-9)
    with pytest.raises(ParameterError, match="shares"):
        NarxObjective(data=data, shares=(0.5, 0.4))


def test_spaces_hold_the_thesis():
    assert {name: (r.low, r.high) for name, r in THESIS.items()} == {
        "na": (5, 10),
        "nb": (5, 10),
        "layers": (2, 10),
        "neurons": (30, 50),
    }
    assert all(WIDER[n].low <= r.low and WIDER[n].high >= r.high for n, r in THESIS.items())


def test_result_table_lists_the_best_first():
    good = TrialResult(number=1, settings={"na": 3}, score=0.5, seconds=1.0)
    bad = TrialResult(number=0, settings={"na": 2}, score=float("inf"), seconds=1.0, failure="why")
    names, rows = columns(SearchResult(trials=(bad, good)))
    assert names == ("trial", "na", "score", "seconds", "failure")
    assert [row[0] for row in rows] == [1, 0]
    with pytest.raises(ParameterError, match="why"):
        _ = SearchResult(trials=(bad,)).best


@pytest.mark.parametrize(
    ("kwargs", "word"),
    [
        ({"space": {}}, "empty"),
        ({"trials": 0}, "trials"),
        ({"workers": 0}, "workers"),
        ({"sampler": "grid"}, "sampler"),
        ({"pruner": "axe"}, "pruner"),
    ],
)
def test_settings_out_of_range(kwargs, word):
    with pytest.raises(ParameterError, match=word):
        quick(**kwargs)


@pytest.mark.parametrize("kwargs", [{"low": 2, "high": 2}, {"low": 0.0, "high": 1.0, "log": True}])
def test_ranges_are_checked(kwargs):
    with pytest.raises(ParameterError, match="range"):
        Range(**kwargs)
