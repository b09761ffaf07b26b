"""The bar: on a terminal, after a while, also in the middle of a single step; never elsewhere."""

import io
import time

import pytest

from slipangle.commands import progress
from slipangle.commands.progress import Bar


class Terminal(io.StringIO):
    def isatty(self):
        return True


def terminal_of(monkeypatch, patience=0.05):
    """Standard error on a terminal; in the test itself, since capturing sets it anew before each."""
    monkeypatch.setattr(progress, "PATIENCE", patience)
    monkeypatch.setenv("TERM", "xterm")
    shown = Terminal()
    monkeypatch.setattr("sys.stderr", shown)
    return shown


def wait_for(text, terminal):
    end = time.monotonic() + 10
    while text not in terminal.getvalue() and time.monotonic() < end:
        time.sleep(0.01)
    return text in terminal.getvalue()


def test_a_single_long_step_is_shown(monkeypatch):
    terminal = terminal_of(monkeypatch)
    with Bar() as bar:
        bar(0.25, "identifying the car")
        assert wait_for("identifying the car", terminal)
        bar(0.5, "judging")
        assert wait_for("judging", terminal)


@pytest.mark.parametrize(("quiet", "patience"), [(True, 0.0), (False, 1000.0)])
def test_quiet_work_and_quick_work_show_nothing(quiet, patience, monkeypatch):
    terminal = terminal_of(monkeypatch, patience)
    with Bar(quiet=quiet) as bar:
        bar(0.5, "identifying")
        time.sleep(0.1)
    assert terminal.getvalue() == ""


def test_elsewhere_it_shows_nothing(monkeypatch):
    shown = io.StringIO()
    monkeypatch.setattr("sys.stderr", shown)
    monkeypatch.setattr(progress, "PATIENCE", 0.0)
    with Bar() as bar:
        bar(0.5, "identifying")
        time.sleep(0.05)
    assert shown.getvalue() == ""
