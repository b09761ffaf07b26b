"""Public files: found locally, fetched, and never accepted with a wrong hash."""

import hashlib

import pytest

from slipangle import errors
from slipangle.data.public import registry
from slipangle.data.public.registry import check, fetch, find_set, list_sets
from tests.conftest import PublicData

GOOD = b"t,u\n0,1\n1,2\n"


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An origin on disk with two files of a set 'toy', an empty cache, no local folder."""
    table = {
        "title": "Toy",
        "description": "d",
        "licence": "l",
        "citation": "c",
        "folder": "toys",
        "origin": "me/repo@abc:data",
        "files": [
            f"{hashlib.sha256(GOOD).hexdigest()} good.csv",
            f"{hashlib.sha256(GOOD).hexdigest()} moved.csv nowhere.csv|/else where/moved.csv",
            f"{hashlib.sha256(b'other').hexdigest()} changed.csv",
            f"{hashlib.sha256(b'third').hexdigest()} other.csv you/theirs@def:x/other.csv",
        ],
    }
    monkeypatch.setattr(registry, "RAW", f"file://{tmp_path}/origin/{{repo}}/{{commit}}/{{path}}")
    toy = registry._read_set("toy", table)
    lost = registry._read_set("lost", {**table, "origin": "", "files": table["files"][:1]})
    monkeypatch.setattr(registry, "list_sets", lambda: (toy, lost))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("SLIPANGLE_DATA", raising=False)
    for path, content in {
        "me/repo/abc/data/good.csv": GOOD,
        "me/repo/abc/else where/moved.csv": GOOD,
        "me/repo/abc/data/changed.csv": GOOD,
        "you/theirs/def/x/other.csv": b"third",
    }.items():
        target = tmp_path / "origin" / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
    return tmp_path


def test_download_once_then_from_the_cache(place):
    told = []
    paths = fetch("toy", "good.csv", progress=told.append)
    assert paths["good.csv"] == place / "cache" / "slipangle" / "toys" / "good.csv"
    assert paths["good.csv"].read_bytes() == GOOD
    assert len(told) == 1
    assert "downloading toys/good.csv from file://" in told[0]
    (place / "origin/me/repo/abc/data/good.csv").unlink()
    assert fetch("toy", "good.csv", progress=told.append) == paths
    assert len(told) == 1


def test_alternatives_and_other_origins(place):
    paths = fetch("toy", "moved.csv", "other.csv")
    assert paths["moved.csv"].read_bytes() == GOOD
    assert paths["other.csv"].read_bytes() == b"third"


def test_local_folder_comes_first(place, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_DATA", str(place / "mine"))
    own = place / "mine" / "toys" / "good.csv"
    own.parent.mkdir(parents=True)
    own.write_bytes(GOOD)
    assert fetch("toy", "good.csv")["good.csv"] == own
    assert not (place / "cache").exists()


@pytest.mark.parametrize("where", ["mine", "cache/slipangle"])
def test_wrong_hash_names_both_and_the_file(place, monkeypatch, where):
    monkeypatch.setenv("SLIPANGLE_DATA", str(place / "mine"))
    bad = place / where / "toys" / "good.csv"
    bad.parent.mkdir(parents=True)
    bad.write_bytes(b"tampered")
    with pytest.raises(errors.HashError) as caught:
        fetch("toy", "good.csv")
    for part in (
        str(bad),
        hashlib.sha256(b"tampered").hexdigest(),
        hashlib.sha256(GOOD).hexdigest(),
        "delete the file",
    ):
        assert part in str(caught.value)
    assert bad.read_bytes() == b"tampered"
    state = check("toy")[0]
    assert not state.good
    assert hashlib.sha256(b"tampered").hexdigest() in state.sentence


def test_wrong_download_keeps_nothing(place):
    with pytest.raises(errors.HashError) as caught:
        fetch("toy", "changed.csv")
    for part in ("data/changed.csv", hashlib.sha256(GOOD).hexdigest(), hashlib.sha256(b"other").hexdigest()):
        assert part in str(caught.value)
    assert not list((place / "cache").rglob("*"))


@pytest.mark.parametrize("raw", ["http://127.0.0.1:9/{repo}/{commit}/{path}", "file:///nowhere/{repo}{commit}{path}"])
def test_no_network_is_one_sentence(place, monkeypatch, raw):
    monkeypatch.setattr(registry, "RAW", raw)
    table = {"title": "", "description": "", "licence": "", "citation": "", "folder": "f", "origin": "a/b@c:d"}
    far = registry._read_set("far", {**table, "files": ["00 x.csv"]})
    monkeypatch.setattr(registry, "list_sets", lambda: (far,))
    with pytest.raises(errors.MissingFileError) as caught:
        fetch("far")
    message = str(caught.value)
    assert "\n" not in message
    for part in ("f/x.csv of 'far'", "cannot be downloaded", "SLIPANGLE_DATA", "expected the network"):
        assert part in message


def test_unknown_names(place):
    with pytest.raises(errors.ParameterError, match="no public data set 'toi'; nearest are 'toy'"):
        fetch("toi")
    with pytest.raises(errors.ParameterError, match=r"no file 'god\.csv'; nearest are 'good\.csv'"):
        fetch("toy", "god.csv")
    with pytest.raises(errors.MissingFileError, match="published nowhere"):
        fetch("lost")


def test_check_downloads_nothing(place):
    states = check("toy")
    assert [s.place for s in states] == [None] * 4
    assert "is not here yet" in states[0].sentence
    fetch("toy", "good.csv")
    assert check("toy")[0].good
    assert "is the published file" in check("toy")[0].sentence


# ---- the table itself --------------------------------------------------------------------------------------------


def test_every_set_states_its_facts():
    names = [s.name for s in list_sets()]
    assert len(set(names)) == len(names)
    for public in list_sets():
        for fact in (public.title, public.description, public.licence, public.citation):
            assert fact.strip()
        assert public.files
        for file in public.files:
            assert len(file.sha256) == 64
            assert set(file.sha256) <= set("0123456789abcdef")
            for url in file.urls:
                assert url.startswith("https://raw.githubusercontent.com/")
                assert len(url.split("/")) >= 7
                assert "//" not in url[8:]
                assert " " not in url
    paths = [f.path for s in list_sets() for f in s.files]
    assert all(".." not in p for p in paths)


def test_the_address_is_the_one_on_github():
    file = find_set("tir").file("VW_microbus__json__mf_185_80R14.tir")
    assert file.urls == (
        "https://raw.githubusercontent.com/projectchrono/chrono/7689fbc/data/vehicle/VW_microbus/json/mf_185_80R14.tir",
    )
    assert find_set("ferrari-250lm").file("vx.txt").urls[0].endswith("/20140222_01_01_03_250lm/vx.txt")


def test_what_else_lies_in_the_folder_does_not_matter(place, monkeypatch):
    own = place / "mine"
    monkeypatch.setenv("SLIPANGLE_DATA", str(own))
    for path in ("toys/notes.txt", "toys/good.csv.bak", "others/good.csv", "README.md"):
        (own / path).parent.mkdir(parents=True, exist_ok=True)
        (own / path).write_bytes(b"x")
    assert [s.place for s in check("toy")] == [None] * 4
    assert fetch("toy", "good.csv")["good.csv"] == place / "cache" / "slipangle" / "toys" / "good.csv"


def test_tests_ask_for_published_files_alone(place, monkeypatch):
    own = place / "mine"
    monkeypatch.setenv("SLIPANGLE_DATA", str(own))
    (own / "toys").mkdir(parents=True)
    data = PublicData(str(own))
    for path, content in {"good.csv": GOOD, "changed.csv": b"not as published", "new.csv": b"of no set"}.items():
        (own / "toys" / path).write_bytes(content)
    assert data("toys/good.csv") == own / "toys" / "good.csv"
    assert data.glob("toys/*") == [own / "toys" / "good.csv"]
    for path in ("toys/changed.csv", "toys/other.csv"):
        with pytest.raises(pytest.skip.Exception, match=f"the published {path} is not in"):
            data(path)
    with pytest.raises(pytest.skip.Exception, match="no published others/"):
        data.glob("others/*")


def test_an_answer_without_end_is_not_taken(place, monkeypatch):
    monkeypatch.setattr(registry, "_LARGEST", len(GOOD) - 1)
    with pytest.raises(errors.MissingFileError, match=r"good\.csv: more than .* MB"):
        fetch("toy", "good.csv")
