"""Sentences of warnings and what they mean, on the page and by the command."""

import re
from pathlib import Path

import pytest

from slipangle.cli import main
from slipangle.report import Finding, Findings, Page, Section
from slipangle.report.tables import Heading, Row, Table
from slipangle.report.why import entries, explained, why_html
from tests.test_docs import TROUBLES, WARNS

DOCS = Path(__file__).parents[2] / "docs" / "troubleshooting.md"
SENTENCE = "mu_f ends at its bound of 3: the data want more"


def test_every_entry_of_the_page_is_read_with_its_text():
    assert sum(len(entry.parts) for entry in entries()) == len(TROUBLES)
    assert all(len(entry.text) > 10 for entry in entries())
    assert not any(re.search(r"\*\*|`|\]\(", entry.text) for entry in entries())


@pytest.mark.parametrize("words", sorted({w for _, told in WARNS.values() for w in told}))
def test_every_warning_is_explained(words):
    text = explained(f"before {words} after")
    assert text
    assert text[1:30] in DOCS.read_text().replace("\n", " ").replace("`", "")


def test_all_the_words_of_a_pair_are_needed():
    assert explained("samples are 20 s apart; expected less than 1").startswith("Usually milliseconds")
    assert explained("samples are few") == ""


def test_a_page_has_the_explanation_under_the_sentence():
    findings = Findings(title="Doubts", items=(Finding(sentence=SENTENCE, tone="poor"), Finding(sentence="fine")))
    table = Table(title="t", columns=(Heading("a"),), rows=(Row(cells=("b",)),), warnings=("x < 1 is coloured (",))
    shown = Page(title="p", sections=(Section(title="s", blocks=(findings, table)),)).to_html()
    assert shown.count('<details class="why">') == 2
    assert f"{explained(SENTENCE)}</details>" in shown
    assert why_html("fine") == ""
    assert "<" not in re.sub(r"</?(details|summary)[^>]*>", "", why_html("x < 1 is coloured ("))


def test_the_command_says_it(capsys):
    assert main(["help", "why", SENTENCE]) == 0
    assert "The optimum is outside the range" in capsys.readouterr().out
    assert main(["help", "why", "white", "errors"]) == 0
    assert "is coloured (" in capsys.readouterr().out
    for given, said in ((["why"], "there are no words"), (["why", "colored"], "nearest")):
        assert main(["help", *given]) == 2
        assert said in capsys.readouterr().err


def test_a_symbol_that_a_text_begins_with_keeps_its_letter():
    assert explained("delta is the angle of the hand wheel").startswith("r wheelbase / v_x is")
    assert explained(SENTENCE).startswith("The optimum")
