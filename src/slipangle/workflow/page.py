"""The page of a job: verdict first, then what it rests on."""

import platform
import shlex
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import version

from slipangle.report import Fact, Page, Section
from slipangle.workflow import evidence, handling
from slipangle.workflow.job import Outcome
from slipangle.workflow.verdict import SECTIONS, verdicts

__all__ = ["SECTIONS", "build_page", "evidence", "handling", "summary"]


def build_page(outcome: Outcome, command: list[str]) -> Page:
    """The whole page; ``command`` is what made it, printed under its numbers."""
    said = shlex.join(command)
    return Page(
        title=outcome.settings.title,
        subtitle=outcome.settings.subtitle,
        sections=tuple(_sections(outcome, said)),
        facts=_facts(outcome),
        command=said,
    )


def _sections(outcome: Outcome, command: str) -> Iterator[Section]:
    for write in SECTIONS.values():
        yield from write(outcome, command)


def _facts(outcome: Outcome) -> tuple[Fact, ...]:
    q = outcome.quality
    return (
        Fact(label="made by", value=f"slipangle {version('slipangle')}, Python {platform.python_version()}"),
        Fact(label="on", value=f"{platform.system()} {platform.machine()}"),
        Fact(label="at", value=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")),
        Fact(label="data", value=f"{outcome.data.name}: {q.samples} samples, {q.duration:.4g} s"),
        Fact(label="split", value=_split(outcome)),
    )


def _split(outcome: Outcome) -> str:
    """What the models were fitted to and judged on, in words."""
    wanted, seconds = outcome.settings.data, f"{outcome.test.duration:.0f} s"
    if wanted.test:
        return f"{outcome.train.name} to fit, free runs over other files, {outcome.test.name}, {seconds}, to judge"
    return f"first {100 * wanted.train:g} % to fit, one free run over the remaining {seconds} to judge"


def summary(outcome: Outcome) -> list[str]:
    """The verdicts as sentences for the terminal."""
    said = [f"{v.title}: {v.tone}. {v.sentence}" for v in verdicts(outcome, "")]
    said += [f"{name}: failed. {reason}" for name, reason in outcome.failures.items()]
    for v in outcome.validations:
        info = v.model.fit_info
        if info is not None:
            said += [f"{v.name}: {sentence}" for sentence in info.corrections]
            said += [f"warning of {v.name}: {sentence}" for sentence in info.warnings]
    return said
