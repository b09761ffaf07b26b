"""What the documentation says is true: numbers, commands, settings, examples, public names."""

import importlib
import inspect
import os
import pkgutil
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

import slipangle
from slipangle.workflow.settings import read_settings
from tests.lowest import constraints, requirements

ROOT = Path(__file__).parents[1]
QUICK = ("log_to_controller.py", "plant_in_another_process.py")  # of the examples
README = (ROOT / "README.md").read_text()


def modules():
    return sorted(m.name for m in pkgutil.walk_packages(slipangle.__path__, "slipangle.") if "__main__" not in m.name)


def test_every_public_name_can_be_imported():
    for name in slipangle.__all__:
        assert getattr(slipangle, name).__module__.startswith("slipangle."), name


def test_a_name_of_the_toolbox_means_one_thing():
    """No public name and no exception is also something else."""
    homes: dict[str, set[str]] = {}
    for name in modules():
        for key, member in vars(importlib.import_module(name)).items():
            if inspect.isclass(member) and member.__module__ == name and not key.startswith("_"):
                homes.setdefault(key, set()).add(name)
    errors = {
        n for n, m in vars(slipangle.errors).items() if inspect.isclass(m) and issubclass(m, (Exception, Warning))
    }
    assert {n: homes[n] for n in {*slipangle.__all__, *errors} if len(homes.get(n, ())) > 1} == {}


def test_load_opens_what_save_wrote(tmp_path):
    model = slipangle.Bicycle(
        params=slipangle.BicycleParams(mass=1200, inertia_z=1500, wheelbase=2.6, l_f=1.2, C_f=8e4, C_r=9e4), dt=0.05
    )
    assert slipangle.load(slipangle.save(model, tmp_path / "car.json")) == model


def test_every_fit_says_what_it_returns():
    """An estimator's `fit`, or the `_fit` that its base calls, is typed with its model: a class, not anything."""
    estimators = {
        member: own
        for name in modules()
        for member in vars(importlib.import_module(name)).values()
        if inspect.isclass(member) and member.__module__ == name
        for own in [vars(member).get("fit") or vars(member).get("_fit")]
        if inspect.isfunction(own)
    }
    assert {slipangle.GreyBox, slipangle.Collocation, slipangle.EKF, slipangle.ARX} < estimators.keys()
    assert {e for e, f in estimators.items() if f.__annotations__.get("return") in (None, "Any", Any)} == set()
    assert (ROOT / "src" / "slipangle" / "py.typed").exists()


@pytest.mark.parametrize("name", modules())
def test_public_functions_say_what_they_take(name):
    """Functions of several arguments describe them; units stand in brackets or the sentence."""
    module = importlib.import_module(name)
    for member in vars(module).values():
        if not inspect.isfunction(member) or member.__module__ != name or member.__name__.startswith("_"):
            continue
        assert member.__doc__, f"{name}.{member.__name__}"
        assert member.__doc__.strip(), f"{name}.{member.__name__}"


def test_settings_in_the_readme_are_valid(tmp_path):
    block = re.search(r"```toml\n(.*?)```", README, re.S)
    assert block is not None
    path = tmp_path / "my_car.toml"
    path.write_text(block.group(1))
    assert read_settings(path).model[0].entries == {"mass": 1200, "wheelbase": 2.6, "l_f": 1.2}


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.toml")), ids=lambda p: p.name)
def test_example_settings_are_valid(path):
    assert read_settings(path).title == tomllib.loads(path.read_text())["title"]


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(p, id=p.name, marks=[pytest.mark.slow] * (p.name not in QUICK))
        for p in sorted((ROOT / "examples").glob("*.py"))
    ],
)
def test_examples_run(path, tmp_path):
    done = subprocess.run(
        [sys.executable, path],
        cwd=tmp_path,
        env={"SLIPANGLE_CFLAGS": "-O1", **os.environ},  # compiled soon: how quick they are is asked elsewhere
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "inside the lanes: True" in done.stdout
    assert len(path.read_text().splitlines()) < 60


@pytest.mark.filterwarnings("ignore::slipangle.errors.IdentifiabilityWarning")
def test_numbers_in_the_readme_are_reproduced(real_data):
    from slipangle.data.public.sets import ferrari_250lm
    from slipangle.models.vehicles.catalogue import FERRARI_250LM

    train, test = ferrari_250lm().split(0.7)
    three = ("C_f", "C_r", "inertia_z")
    for free in (three, (*three, "steering_gain", "steering_offset", "l_f")):
        start = slipangle.Bicycle(params=FERRARI_250LM, dt=train.dt)
        score = slipangle.validate(slipangle.GreyBox(start=start, free=free).fit(train), test).free_run_scores["r"]
        assert f"| {score.fit:.2f} % | {score.vaf:.2f} % |" in README


def test_links_in_the_readme_exist():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_commands_in_the_readme_exist(capsys):
    from slipangle.cli import main

    for command in set(
        re.findall(r"slipangle (demo|run|data|reproduce|bench|tire|identify|validate|compare)\b", README)
    ):
        with pytest.raises(SystemExit) as stop:
            main([command, "--help"])
        assert stop.value.code == 0
    capsys.readouterr()


def test_nomenclature_names_are_the_models():
    text = (ROOT / "docs" / "nomenclature.md").read_text()
    from slipangle.models.vehicles.bicycle import Bicycle
    from slipangle.models.vehicles.kinematic import Kinematic
    from slipangle.models.vehicles.longitudinal import Longitudinal
    from slipangle.models.vehicles.single_track import SingleTrack

    for model in (Bicycle, Kinematic, Longitudinal, SingleTrack):
        for name in (*model.states, *model.inputs):
            assert f"`{name}`" in text, name


def test_every_requirement_names_its_lowest_version():
    assert len(constraints()) == sum(map(len, requirements().values()))


def test_tools_that_judge_are_exact_and_read_what_is_installed():
    """No newer linter, type checker or stub changes a verdict; no package is left out of the types."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text())
    groups = table["dependency-groups"]
    assert all(re.fullmatch(r"[\w-]+(\[\w+\])?==[\d.]+", line) for line in groups["lint"] + groups["types"])
    names = [
        {re.split(r"[=>]", line)[0] for line in lines}
        for lines in (groups["types"], requirements()["core"] + requirements()["neural"])
    ]
    assert names[0] == names[1]
    floor = re.search(r">=([\d.]+)", table["project"]["requires-python"])[1]
    assert table["tool"]["pyright"]["pythonVersion"] == floor
    assert f"python{floor}/site-packages" in (ROOT / "Makefile").read_text()


@pytest.mark.parametrize(
    "name", ["README.md", *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md"))]
)
def test_the_docs_name_what_is_there(name):
    """Public names, and attributes of what a table names; links are looked at with the site."""
    text = (ROOT / name).read_text()
    assert set(re.findall(r"\bsa\.(\w+)", text)) <= set(slipangle.__all__)
    for kind, attribute in re.findall(r"\bsa\.([A-Z]\w+)\.(\w+)", text):
        assert hasattr(getattr(slipangle, kind), attribute), f"{kind}.{attribute}"


def test_what_a_matlab_user_is_told_is_there():
    """Methods and settings in the table, of data, models, linear systems and estimators."""
    from slipangle.models.analysis.linearised import LinearisedModel

    text = (ROOT / "docs" / "from-matlab.md").read_text()
    owners = {"data": slipangle.Dataset, "model": slipangle.Model, "linear": LinearisedModel, "mpc": slipangle.MPC}
    for owner, attribute in re.findall(r"\b(data|model|linear|mpc)\.(\w+)", text):
        assert hasattr(owners[owner], attribute), f"{owner}.{attribute}"
    for kind, inside in re.findall(r"sa\.(ARX|StateSpace|GreyBox|linearize)\(([^)]*)\)", text):
        known = inspect.signature(getattr(slipangle, kind)).parameters
        assert set(re.findall(r"(\w+)=", inside)) <= set(known), kind
    assert {"values", "covariance", "candidates"} <= set(inspect.signature(slipangle.FitInfo).parameters)


TROUBLES = re.findall(r'\*\*"(.*?)"\*\*', (ROOT / "docs" / "troubleshooting.md").read_text())
SOURCE = {p.relative_to(ROOT / "src" / "slipangle").as_posix(): p.read_text() for p in (ROOT / "src").rglob("*.py")}
# Files that warn, how often, and words of each sentence that they may warn with.
WARNS = {
    "codegen/compiler.py": (2, ("did not compile", "no C compiler was found")),
    "commands/export.py": (1, ("does not say all that a lap hangs on",)),
    "commands/tire.py": (1, ("no unloaded radius is given",)),
    "control/mpc.py": (1, ("the duration makes stages of",)),
    "control/phases.py": (1, ("the duration makes stages of",)),
    "control/racing/racer.py": (1, ("leaves nothing to correct with",)),
    "data/readers/tir.py": (1, ("is read as the rest of the comment above it",)),
    "identify/adapt.py": (1, ("the model is left as it is",)),
    "identify/car/identify_car.py": (
        1,
        (
            *("cannot be separated:", "ends at its bound", "differs between the recordings:"),
            *("as the motion of the car tells", "s apart, and the yaw rate follows"),
        ),
    ),
    "identify/judge/validate.py": (
        2,
        ("whether the model was fitted to some of these data cannot be told", "in place of"),
    ),
    "identify/excitation.py": (1, ("hold the same samples, which then count twice",)),
    "identify/lure/lure.py": (1, ("the fit stopped at its limit of", "starts reached the best minimum; expected two")),
    "identify/networks/estimator.py": (1, ("training diverged before epoch", "training starts from random weights")),
    "identify/networks/joint_problem.py": (1, ("never improved on the physics it started from",)),
    "identify/networks/narx_free_run.py": (1, ("no free run on the held-out part stayed finite",)),
    "identify/physics/grey_box.py": (
        1,
        (
            *("the data do not determine", "can hardly be told apart", "the outputs do not depend on"),
            *("ends at its bound", "between their samples rather than"),
        ),
    ),
    "identify/stability.py": (
        1,
        (
            *("the model is unstable: it has a pole of modulus", "do not tell the effect of", "is coloured ("),
            "looks white, but a free run of the model tells",
            "the data have a level that a model without a constant cannot hold",
        ),
    ),
    "paths/track_columns.py": (1, ("which is left out: tracks here are flat",)),
    "optimal/lap/cars.py": (1, ("does not say all that a lap hangs on",)),
    "optimal/lap/fastest_lap.py": (1, ("the lap time may be off by percents",)),
    "optimal/lap/resolved.py": (2, ("turns to and fro by", "goes along itself again")),
    "identify/tires/curves.py": (1, ("the data do not determine", "the fit stopped at its budget")),
    "identify/tires/magic_formula.py": (
        2,
        (
            "the data hold no longitudinal sweep",
            "the data hold no lateral sweep",
            "the data hold no combined slip",
            "its coefficients stay those of the start tire",
            "at the edge of the usual range",
            "a stage stopped at its budget",
        ),
    ),
    "identify/tires/whole_tire.py": (1, ("the data do not determine", "ends at its bound")),
    "models/analysis/linearize.py": (1, ("is not smooth in",)),
    "models/black_box/model.py": (1, ("no C compiler was found",)),
    "models/model.py": (1, ("goes astray", "lie outside of the training data")),
    "models/storage.py": (1, ("where its fit found",)),
    "models/tires/magic_formula/tir.py": (
        5,
        (
            "used as it stands, because force was given",
            "no limit, because force was given",
            "has a slip stiffness below zero",
            "changes its sign with load",
            "Magic Formula does not use",
        ),
    ),
    "models/tires/magic_formula/tire.py": (1, ("the tire is extrapolated",)),
    "models/vehicles/parameters.py": (1, ("kg at a wheelbase of", "expected the centre of gravity between")),
    "optimal/ocp.py": (1, ("is neither limited nor has a weight",)),
    "optimal/realtime/backend.py": (1, ("no C compiler was found",)),
    "registry.py": (1, ("of an installed package cannot be used",)),
    "reproduce/plants/friction.py": (1, ("the fit stopped at its limit of",)),
}


def test_troubleshooting_repeats_sentences_of_the_source():
    joined = [re.sub(r'"\s*\n\s*f?"', "", text) for text in SOURCE.values()]  # sentences that are broken over lines
    assert len(TROUBLES) == len(set(TROUBLES)) >= 40
    assert [p for p in TROUBLES if not any(p.removesuffix(" ...") in text for text in joined)] == []


def test_every_warning_has_an_entry():
    """A file that warns, or warns once more, says here with which words, and they are explained."""
    assert {f: text.count("warnings.warn(") for f, text in SOURCE.items() if "warnings.warn(" in text} == {
        file: count for file, (count, _) in WARNS.items()
    }
    entries = {entry.removesuffix(" ...") for entry in TROUBLES}
    assert {words for _, told in WARNS.values() for words in told} - entries == set()


def test_the_citation_is_that_of_the_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = dict(re.findall(r"^([\w-]+): (.+)$", (ROOT / "CITATION.cff").read_text(), re.M))
    assert lines["version"] == project["version"]
    assert lines["license"] == project["license"]
    assert lines["cff-version"] == "1.2.0"
