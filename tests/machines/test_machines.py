"""The matrix itself: it covers what it says, and it notices a number that differs."""

import math
import sys
from itertools import combinations, product

import pytest

from tests.machines import __main__ as machines
from tests.machines.combinations import KERNELS, Combination, design
from tests.machines.registry import Fit, load


@pytest.mark.parametrize(("a", "b"), list(combinations(("kernel", "threads", "xla", "c"), 2)))
def test_every_pair_of_settings_occurs(a, b):
    found = {(getattr(c, a), getattr(c, b)) for c in design()}
    assert found == set(product(*({getattr(c, k) for c in design()} for k in (a, b))))


def test_the_first_five_hold_every_setting():
    first = design()[:5]
    assert {c.kernel for c in first} == set(KERNELS)
    assert {c.threads for c in first} == {1, 2}
    assert {c.xla for c in first} == {"SSE4_2", "AVX2"}
    assert {c.c for c in first} == {"native", "portable", "none"}


def test_environment_of_a_machine(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_dump_to=x")
    env = Combination("Nehalem", 2, "SSE4_2", "none").environment()
    assert (env["OPENBLAS_CORETYPE"], env["OPENBLAS_NUM_THREADS"], env["SLIPANGLE_CC"]) == ("Nehalem", "2", "none")
    assert env["XLA_FLAGS"] == "--xla_dump_to=x --xla_cpu_max_isa=SSE4_2"
    assert Combination("Zen", 1, "AVX2", "portable").environment()["SLIPANGLE_CFLAGS"] == "-O3"


def test_one_is_chosen_by_the_hash_alone():
    assert machines.chosen("ab12", None) == machines.chosen("ab12", 3)
    assert len({str(machines.chosen(f"{k:x}", None)[0][0]) for k in range(40)}) > 5


def test_three_commits_in_a_row_of_hashes_choose_every_test_once():
    chosen = [machines.share(f"a{k:039x}") for k in range(3)]
    assert sorted(file for files in chosen for file in files) == machines.share(None)
    assert len(machines.share(None)) > 50


def test_differences_and_broken_bounds_are_noticed(monkeypatch, capsys):
    answers = iter([{"train": 1.0, "validation": 1.0}, {"train": 1.02, "validation": 1.02}])
    monkeypatch.setattr(machines, "_run", lambda *_: {**next(answers), "seconds": 0.0})
    wrong = machines._matrix({"a": Fit(dict, {"validation": 1.01})}, [Combination(), design()[0]], 1, 1.0)
    assert len(wrong) == 2
    assert wrong[0].endswith("validation 1.02 > 1.01")
    assert wrong[1] == "a: train differs by 2 %, at most 1 %"
    assert "spread of validation: 2 % (at most 3 %)" in capsys.readouterr().out
    assert machines.spread([1.0, math.nan]) == math.inf


def test_a_fit_that_crashes_is_a_failure(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    assert machines._run("any", Combination(), 10.0).startswith("exit code 1")


def test_tests_that_do_not_end_are_a_failure(monkeypatch, capsys):
    class Wrong(Combination):
        def environment(self):
            return {**super().environment(), "PYTEST_ADDOPTS": "--help-me"}

    assert machines._tests(Wrong("Zen"), 1, 60.0, machines.share(None)) != 0  # an option that pytest does not know
    assert machines._tests(Combination("Zen", c="none", xla="AVX2"), 1, 0.5, machines.share(None)) == 1
    assert "not done after 0.5 s" in capsys.readouterr().out


def test_there_are_fits_of_every_kind():
    names = " ".join(load())
    for kind in ("Lure", "NARX", "NARX by its free run", "neural state space", "Magic Formula", "state space", "ARMAX"):
        assert kind in names
