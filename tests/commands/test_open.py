"""The last page is shown, and a page is there while a search goes on."""

import argparse
import os
import re
import webbrowser

import pytest

from slipangle.cli import main
from slipangle.commands import search
from slipangle.identify.search.search import SearchResult, TrialResult


@pytest.fixture
def shown(monkeypatch):
    seen = []
    monkeypatch.setattr(webbrowser, "open", lambda uri: seen.append(uri) or True)
    return seen


def test_the_last_page_of_a_folder_is_shown(tmp_path, monkeypatch, shown, capsys):
    monkeypatch.chdir(tmp_path)
    for k, name in enumerate(("slipangle-out/b/index.html", "slipangle-out/a/index.html", "slipangle-out/c.html")):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("page")
        os.utime(tmp_path / name, (1e9 - abs(k - 1), 1e9 - abs(k - 1)))
    assert main(["open"]) == 0
    assert shown == [(tmp_path / "slipangle-out/a/index.html").as_uri()]
    assert capsys.readouterr().out.strip().endswith("index.html")
    assert main(["open", "slipangle-out/c.html"]) == 0
    assert main(["open", "slipangle-out/b"]) == 0
    assert [uri.rpartition("slipangle-out/")[2] for uri in shown[1:]] == ["c.html", "b/index.html"]


def test_without_a_page_or_a_browser_it_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["open"]) == 2
    assert "there is no page in 'slipangle-out'; expected" in capsys.readouterr().err
    (tmp_path / "page.html").write_text("page")
    monkeypatch.setattr(webbrowser, "open", lambda uri: False)
    assert main(["open", "page.html"]) == 0
    assert "no browser here" in capsys.readouterr().out


def trial(number, failure=""):
    return TrialResult(number=number, settings={"na": number + 1}, score=1.0, seconds=1.0, failure=failure, steps=())


def test_a_page_is_there_while_a_search_goes_on(tmp_path):
    options = argparse.Namespace(
        out=str(tmp_path), file="job.toml", trials=4, seed=0, space="wider", epochs=7, pruner="none"
    )
    written, page = search._Written(options, "a log"), tmp_path / "index.html"
    written(SearchResult(trials=(trial(0, "too many lags"),)))
    assert not page.exists()  # nothing to draw yet
    written(SearchResult(trials=(trial(0), trial(1))))
    text = page.read_text()
    assert "2 of 4 trials so far" in text
    assert re.search(r'http-equiv="refresh" content="\d+"', text)
    written(SearchResult(trials=(trial(0), trial(1), trial(2))))
    assert page.read_text() == text  # not again at once
    search._page(SearchResult(trials=tuple(map(trial, range(4)))), options, "a log")
    assert "so far" not in page.read_text()
    assert "--space wider --epochs 7 --pruner none" in page.read_text()
    assert "refresh" not in page.read_text()
