"""The reference of job files and their JSON schema say what the reader of jobs does."""

import json
import re
import tomllib
from dataclasses import MISSING, dataclass
from inspect import signature
from pathlib import Path
from typing import Annotated

import pytest

from slipangle.cli import main
from slipangle.control.mpc import MPC
from slipangle.errors import ConfigError, SlipangleError
from slipangle.fields import Within
from slipangle.workflow.demo import _SETTINGS as DEMO
from slipangle.workflow.drive import CONTROLLERS, PLANTS
from slipangle.workflow.hints import called, words
from slipangle.workflow.kinds import KINDS
from slipangle.workflow.reference import markdown, tables
from slipangle.workflow.schema import job_schema
from slipangle.workflow.settings import read_settings
from tests.workflow.test_cli import JOB, write_job

ROOT = Path(__file__).parents[2]
MODEL = '[[model]]\nname = "x"\n'
PAGE = ROOT / "docs" / "job-reference.md"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCKS = [block for page in PAGES for block in re.findall(r"```toml\n(.*?)```", page.read_text(), re.S)]
JOBS = [path.read_text() for path in sorted((ROOT / "examples").glob("*.toml"))]
JOBS += [DEMO.format(seconds=9, columns=""), JOB.format(more="")]
JOBS += [block for block in BLOCKS if "[[model]]" in block and "[data]" in block]


def test_the_page_is_what_the_records_say():
    """Written again by: slipangle help job --markdown > docs/job-reference.md."""
    assert PAGE.read_text() == markdown(list(tables().values()))


def test_every_key_has_a_meaning_and_every_table_a_sentence():
    for table in tables().values():
        assert len(table.about) > 8, table.name
        for key in table.keys:
            assert len(key.meaning) > 7, f"{table.name}: {key.name}"
            assert key.takes != "anything", f"{table.name}: {key.name}"


def test_every_kind_has_a_table():
    names = tables().keys()
    for group, kinds in {"model": KINDS, "controller": CONTROLLERS, "plant": PLANTS}.items():
        assert {f"{group}.{kind}" for kind in kinds} <= names


def test_defaults_are_those_of_python():
    """Each key of a table of a class stands in its constructor with the same default."""
    for kind, thing in KINDS.items():
        if not isinstance(thing, type):
            continue
        takes = signature(thing).parameters
        for key in tables()[f"model.{kind}"].keys:
            default = takes[key.name].default
            if key.entry.default is MISSING:
                assert default is takes[key.name].empty
            elif str(default) != "<factory>":
                assert key.entry.default == default
    ours = {key.name: key.entry.default for key in tables()["controller.mpc"].keys}
    assert ours["solver"] == signature(MPC).parameters["solver"].default == "realtime"


# ---- the command ---------------------------------------------------------------------------------------------------


def test_help_prints_one_table_or_all(capsys):
    assert main(["help", "job", "state-space"]) == 0
    said = capsys.readouterr().out
    assert said.startswith('model.state-space: [[model]] with kind = "state-space"')
    assert re.search(r"max_radius\s+a positive number, such as 0.999; optional\n\s+Largest modulus of the poles", said)
    assert main(["help", "job", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [t["table"] for t in listed] == list(tables())
    rate = next(k for t in listed if t["table"] == "data" for k in t["keys"] if k["name"] == "rate")
    assert rate["takes"] == "a number from 0.0001 to 100000 Hz"
    assert main(["help", "run"]) == 0
    assert capsys.readouterr().out.startswith("usage: slipangle run")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["job", "dta"], r"no table 'dta'; nearest are 'data', 'stage': use one"),
        (["rnu"], r"no command 'rnu'; nearest are .*'run'"),
        (["run", "--schema"], r"expected: slipangle help job --schema"),
    ],
)
def test_help_of_what_is_not_there(words, said, capsys):
    assert main(["help", *words]) == 2
    assert re.search(said, capsys.readouterr().err)


def test_an_unknown_key_gets_all_near_ones_uncut(tmp_path):
    """Of 25 keys that are alike, none is left out, and where none is alike, all are said."""
    every = [key.name for key in tables()["model.joint"].keys]
    for entry, names in {"weight_prio": ["weight_prior"], "xyz": every}.items():
        with pytest.raises(ConfigError) as caught:
            read_settings(write_job(tmp_path, more=f"{MODEL}kind = 'joint'\n{entry} = 1"))
        for name in names:
            assert repr(name) in str(caught.value)
        assert "..." not in str(caught.value)


# ---- the schema ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def check():
    jsonschema = pytest.importorskip("jsonschema", reason="an independent reader of schemas")
    schema = job_schema()
    jsonschema.Draft7Validator.check_schema(schema)
    return jsonschema.Draft7Validator(schema)


def test_what_init_writes_is_valid(check, tmp_path, capsys):
    write_job(tmp_path, head=("time [s]", "steering angle [deg]", "speed [km/h]", "yaw rate [deg/s]"))
    assert main(["init", str(tmp_path / "log.csv"), "--out", str(tmp_path / "new.toml")]) == 0
    capsys.readouterr()
    assert [e.message for e in check.iter_errors(tomllib.loads((tmp_path / "new.toml").read_text()))] == []


@pytest.mark.parametrize("job", JOBS, ids=range(len(JOBS)))
def test_jobs_that_are_read_are_valid(job, check):
    assert [e.message for e in check.iter_errors(tomllib.loads(job))] == []


WRONG = {
    "unknown key": MODEL + 'kind = "arx"\nma = 2',
    "key of another kind": MODEL + 'kind = "arx"\nnf = 2',
    "unknown kind": MODEL + 'kind = "arks"',
    "no kind": MODEL,
    "name of nothing": MODEL + "kind = 3",
    "word for a number": MODEL + 'kind = "arx"\nna = "two"',
    "out of range": MODEL + 'kind = "car"\nmass = -1\nwheelbase = 2.6\nl_f = 1.2',
    "missing": MODEL + 'kind = "car"\nmass = 1200',
    "unknown parameter": MODEL + 'kind = "bicycle"\ncar = { maas = 1200 }',
    "number for a log": MODEL + 'kind = "adapt"\nmodel = "bicycle"\ntrain = 3',
    "unknown table": "[controler]\nmodel = 'x'",
    "inner table": MODEL + 'kind = "hybrid"\ndiscrepancy = { kind = "narx", hiden = [3] }',
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_refused_is_invalid_too(case, check, tmp_path):
    job = JOB.format(more="") + WRONG[case]
    assert list(check.iter_errors(tomllib.loads(job)))
    with pytest.raises(SlipangleError):
        read_settings(write_job(tmp_path, more=WRONG[case]))


CAR = "mass = 1200\nwheelbase = 2.6\nl_f = 1.2\n"
RIGHT = {
    "lists and words": MODEL + 'kind = "arx"\nna = "chosen"\nnb = [2, 1]\nnk = 1',
    "a number for a list": MODEL + 'kind = "narx"\nseeds = 3',
    "an inner table": MODEL + f'kind = "hybrid"\n{CAR}discrepancy = {{ hidden = [3] }}',
    "another model": MODEL + 'kind = "lure"\nlinear = "bicycle"',
    "another log": MODEL + 'kind = "adapt"\nmodel = "bicycle"\ntrain = ["log.csv"]',
    "another log alone": MODEL + 'kind = "adapt"\nmodel = "bicycle"\ntrain = "log.csv"',
    "an inner kind": MODEL + 'kind = "lure"\nlinear = { order = 2, max_radius = 0.99 }',
    "a controller": '[controller]\nmodel = "bicycle"\nhorizon = 10\nQ = { Y = 2 }\n[plant]\nfriction = 0.8',
    "an FMU": '[plant]\nkind = "fmu"\nfile = "car.fmu"\ninputs = { delta = "SWA" }\nparameters = { mu = 0.8 }',
    "a process": '[plant]\nkind = "process"\naddress = "127.0.0.1:5005"',
}


@pytest.mark.parametrize("case", RIGHT)
def test_what_is_valid_is_read_too(case, check, tmp_path):
    assert [e.message for e in check.iter_errors(tomllib.loads(JOB.format(more="") + RIGHT[case]))] == []
    assert read_settings(write_job(tmp_path, more=RIGHT[case]))


def test_an_inner_table_changes_its_default_only(tmp_path):
    """A hybrid's network keeps what its table does not say; without a table it is the default."""
    *_, model = read_settings(write_job(tmp_path, more=RIGHT["an inner table"])).model
    usual = next(k for k in tables()["model.hybrid"].keys if k.name == "discrepancy").entry.default
    network = model.entries["discrepancy"]
    assert (network.hidden, network.stages, network.na) == ((3,), usual.stages, 5)


# ---- what keys come from -------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class YawGain:
    """Estimator of a gain.

    Parameters
    ----------
    window : float
        Length of what is averaged. [s]
    """

    window: Annotated[float, Within(0, 10, "s")] = 1.0


def test_a_registered_class_is_in_the_reference_and_the_schema(monkeypatch):
    monkeypatch.setattr(KINDS, "_things", dict(KINDS))
    KINDS.register("yaw-gain")(YawGain)
    (key,) = tables()["model.yaw-gain"].keys
    assert (key.name, key.takes, key.default) == ("window", "a number from 0 to 10 s", "1")
    assert key.meaning == "Length of what is averaged. [s]"
    options = job_schema()["definitions"]["model"]["oneOf"]
    own = next(o["properties"] for o in options if o["properties"]["kind"]["const"] == "yaw-gain")
    assert (own["window"]["minimum"], own["window"]["maximum"]) == (0, 10)


def test_names_and_words():
    names = [called(type(n, (), {})) for n in ("ARX", "BoxJenkins", "FreeRunNARX", "MultiARX", "EKF", "DataSettings")]
    assert names == ["arx", "box-jenkins", "free-run-narx", "multi-arx", "ekf", "data"]
    assert words(int | tuple[int, ...] | None) == "a whole number, or a list, each a whole number"


def test_a_setting_says_when_it_is_not_used_and_what_it_does_alone():
    """In the line that help prints, which is the first sentence of the docstring."""
    said = {key.name: key.meaning for key in tables()["data"].keys}
    assert "test files" in said["train"]
    assert "without a rate" in said["cutoff"]
