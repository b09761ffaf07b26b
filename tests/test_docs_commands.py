"""Commands of README and docs: each is understood, with its options, choices, tables and benchmarks."""

import importlib.util
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import slipangle as sa
from slipangle.cli import _joined, _parser, main
from slipangle.reproduce import find, find_benchmark
from slipangle.workflow.demo import prepare_demo
from tests.docs_things import write_run
from tests.rig import TIRE, channels, write_dat

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```([\w{}-]*)\n(.*?)^```$", re.S | re.M)
INLINE = re.compile(r"`(slipangle [^`]+)`")
LINE = re.compile(r"^(?:    )?(?:\.venv/bin/)?(slipangle .*)$", re.M)


JOB = """
[data]
file = "run.csv"
inputs = ["delta", "v_x"]
outputs = ["r"]
rate = 20

[data.columns]
delta = { column = "steer", unit = "deg" }
v_x = { column = "speed", unit = "km/h" }
r = { column = "yaw rate", unit = "deg/s" }

[[model]]
name = "car"
kind = "bicycle"
car = { mass = 1200, inertia_z = 1500, wheelbase = 2.6, l_f = 1.2, C_f = 6e4, C_r = 6e4 }
free = ["C_f", "C_r"]

[controller]
model = "car"
v_x = 15.0
cars = 0

"""
QUICK = re.compile(r"^slipangle (inspect|init|help|list|doctor|completion)\b")  # others fit, drive or compile


def commands() -> list[str]:
    """Every command that starts with slipangle, of blocks, indented lines and the text."""
    found = set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        shell = [block for language, block in BLOCK.findall(text) if not language]
        for block in [*shell, BLOCK.sub("", text)]:
            found |= {line.strip() for line in LINE.findall(block)}
        found |= {line for line in INLINE.findall(text) if not re.search(r"[A-Z]{3,}|\.\.\.| > ", line)}
    return sorted(found)


def words(command: str) -> list[str]:
    return _joined(shlex.split(command, comments=True)[1:])


def named_only(given: list[str]) -> bool:
    """Whether a page speaks of a command and its options, without the file that it takes."""
    alone = all(word.startswith("-") for word in given[1:])
    return alone and given[0] not in ("demo", "list", "doctor", "reproduce", "bench", "open")


@pytest.mark.parametrize("command", commands())
def test_a_command_is_understood(command, capsys):
    """Its options and choices are there, and so are the tables and benchmarks that it names."""
    given = words(command)
    if named_only(given):
        with pytest.raises(SystemExit) as stop:
            main([*given[:1], "--help"])
        assert stop.value.code == 0
        assert all(option in capsys.readouterr().out for option in given[1:])
        return
    options = _parser().parse_args(given)
    assert options.function is not None
    for name in getattr(options, "names", []) if options.command in ("reproduce", "bench") else []:
        assert find(name) if options.command == "reproduce" else find_benchmark(name)


def test_make_targets_are_there():
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M))
    named = {t for page in PAGES for t in re.findall(r"(?:^|`)make ([a-z][\w-]+)", page.read_text(), re.M)}
    assert {"demo", "test", "docs"} <= named <= targets


def scripts() -> list[str]:
    """What README and docs start with Python: files of the checkout, and modules of it by -m."""
    said = r"python ((?:-m [\w.]+|(?:examples|benchmarks)/[\w/]+\.py)[^\n`#<]*)"
    return sorted({command.strip() for page in PAGES for command in re.findall(said, page.read_text(encoding="utf-8"))})


@pytest.mark.parametrize("command", scripts())
def test_a_script_is_there_and_knows_its_options(command):
    given = shlex.split(command)
    if given[0] == "-m":
        spec = importlib.util.find_spec(given[1])
        assert spec is not None
        if spec.submodule_search_locations is not None:
            spec = importlib.util.find_spec(f"{given[1]}.__main__")
        assert spec is not None
        assert spec.origin is not None
        place = Path(spec.origin)
    else:
        place = ROOT / given[0]
    text = place.read_text(encoding="utf-8")
    assert place.parent.name == "examples" or '"__main__"' in text or place.name == "__main__.py"
    assert [option for option in given if option.startswith("--") and f'"{option}"' not in text] == []


def test_scripts_are_found():
    assert len(scripts()) > 7
    assert any(command.startswith("-m tests.fuzz --seconds") for command in scripts())


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The files that the commands speak of."""
    monkeypatch.chdir(tmp_path)
    write_run(tmp_path / "run.csv")
    for name in ("run.toml", "job.toml", "my_car.toml"):
        Path(name).write_text(f'title = "{name}"\nout = "out-{name}"\n{JOB}')
    return tmp_path


def test_commands_that_fit_nothing_run(folder, capsys):
    """Those on logs and jobs, in one folder with files of these names."""
    done = {}
    for command in commands():
        given = words(command)
        if not QUICK.match(command) or named_only(given) or ".ld" in command or ".mcap" in command:
            continue
        done[command] = main([*given, "--force"] if given[0] == "init" else given), capsys.readouterr().err
    assert len(done) >= 5
    assert {command: said for command, (code, said) in done.items() if code} == {}


LAP = """
[[model]]
name = "limits"
kind = "saturating-bicycle"
car = { mass = 1200, inertia_z = 1600, wheelbase = 2.6, l_f = 1.2, C_f = 8e4, C_r = 9e4, mu_f = 1.1, mu_r = 1.1 }
free = ["C_f"]

[lap]
track = "track.csv"
points = 60
set = { power = 1e5 }
"""
SHORT = {"--cars": "20"}  # what a page asks for, in a test's time
ELSEWHERE = {  # commands that tests of their own run, or that need more than a folder
    "slipangle reproduce": "tests/reproduce, and docs/gallery has what they printed",
    "slipangle bench": "tests/benchmarks/test_small.py, in little",
    "slipangle run examples/": "tests/workflow/test_cli.py",
    "slipangle data": "tests/data",
    "slipangle completion": "tests/commands/test_completion.py",
    "slipangle inspect drive.mcap": "tests/data/readers",
    "slipangle inspect run.ld": "tests/commands/test_new_users.py",
    "slipangle init run.ld": "tests/commands/test_new_users.py",
}


@pytest.fixture
def whole(folder):
    """The same, with a track, a lap, tires, a saved model and the tutorial's files."""
    angle = np.linspace(0, 2 * np.pi, 120)[:-1]
    radius = 80 + 20 * np.cos(2 * angle)
    X, Y = radius * np.cos(angle), radius * np.sin(angle)
    width = np.full(len(angle), 5.0)
    head = "x_m,y_m,w_tr_right_m,w_tr_left_m"
    np.savetxt("track.csv", np.column_stack([X, Y, width, width]), delimiter=",", header=head)
    t = 0.2 * np.arange(500)
    around = 15.0 * t / 80
    drive = np.column_stack([t, *(np.interp(around % (2 * np.pi), angle, c, period=2 * np.pi) for c in (X, Y))])
    np.savetxt("log.csv", drive, delimiter=",", header="t [s],X [m],Y [m]", comments="")
    for name in ("job.toml", "my_car.toml"):
        path = Path(name)
        path.write_text(path.read_text() + LAP)
    TIRE.write_tir(Path("tire.tir"))
    write_dat(Path("cornering.dat"), {k: v[::8] for k, v in channels().items()})
    write_dat(Path("drive.dat"), {k: v[::8] for k, v in channels("drive/brake").items()})
    Path("models").mkdir()
    car = sa.BicycleParams(mass=1200, inertia_z=1600, wheelbase=2.6, l_f=1.2, C_f=8e4, C_r=9e4)
    sa.save(sa.Bicycle(params=car, dt=0.05, outputs=("r",)), "models/car.json")
    return folder


def others() -> list[str]:
    """Commands that fit, drive, compile or export."""
    return [c for c in commands() if not QUICK.match(c) and not c.startswith(tuple(ELSEWHERE)) and not bare(c)]


def bare(command: str) -> bool:
    return named_only(words(command)) and words(command)[0] != "demo"


@pytest.mark.slow
@pytest.mark.parametrize("command", others())
def test_every_other_command_runs(command, whole, capsys, monkeypatch):
    given = words(command)
    if "--cluster" in given and importlib.util.find_spec("ray") is None:
        pytest.skip("Ray is not installed: pip install 'slipangle[cluster]'")
    if "tutorial/demo.toml" in given:
        prepare_demo("tutorial")
    if given[0] == "open":
        (whole / "slipangle-out").mkdir()
        (whole / "slipangle-out" / "report.html").write_text("<p>a page</p>")
        monkeypatch.setattr("webbrowser.open", lambda url: True)
    given = [SHORT.get(before, word) for before, word in zip(["", *given], given, strict=False)]
    code = main(given)
    assert code in ((0, 1) if given[0] in ("run", "demo", "robust") else (0,)), capsys.readouterr().err
