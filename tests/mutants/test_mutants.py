"""The list of mutants fits the source; `make mutants` runs it."""

from collections import Counter

import pytest

from tests.mutants.__main__ import ALL
from tests.mutants.listed import ROOT, SOURCE, Mutant


@pytest.mark.parametrize("mutant", ALL, ids=lambda m: m.name)
def test_a_mutants_text_occurs_exactly_once(mutant):
    """A line that was rewritten takes its mutant along: change the list with it."""
    text = (ROOT / SOURCE / mutant.file).read_text(encoding="utf-8")
    assert mutant.broken(text) != text
    for test in mutant.tests:
        assert (ROOT / "tests" / test.split("::")[0]).is_file(), test


def test_there_are_enough_and_no_name_twice():
    assert len(ALL) >= 60
    assert max(Counter(m.name for m in ALL).values()) == 1


@pytest.mark.parametrize("text", ["", "a a"])
def test_a_text_that_does_not_occur_once_is_refused(text):
    with pytest.raises(ValueError, match="expected once"):
        Mutant("m", "f.py", "a", "b", ()).broken(text)
