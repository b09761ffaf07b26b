"""Every benchmark, each that README or docs name among them, runs to its end in little: numbers, no speeds."""

import itertools
import re
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.foreign_cars import judge
from benchmarks.foreign_cars.mistakes import MISTAKES

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.identify.networks.problem import Stage
from slipangle.reproduce import benchmark_names, find_benchmark

ROOT = Path(__file__).parents[2]
ONE = {"ROUNDS": 1}
# What makes a benchmark small: constants of its module, and arguments of its `bench`.
SMALL: dict[str, dict[str, Any]] = {
    "adapt": {"SECONDS": (30.0,)},
    "arx": ONE | {"SAMPLES": 20_000, "FEWER": 5_000, "CHOICES": (500,)},
    "compile": ONE | {"PLANS": 3, "STATES": 12, "STATE_ROUNDS": 1},
    "coverage": {"SETS": 2, "JUDGED": 2, "N": 300},
    "csv": {"megabytes": 1.0},
    "driver": {"seeds": (0,), "SPEEDS": [20.0], "SLOWER": (12.0,), "TUNED": ((3.0, 0.0),)},
    "driver-fleet": {"seeds": (0,)},
    "driver-lap": {"seeds": (0,), "CARS": {"sports car": 10.0}, "BOUNDS": {"late pose": 4.0}},
    "foreign-cars": {"cars": ("1:10 car",)},
    "free-run": ONE | {"SAMPLES": 1_000},
    "horizon": ONE | {"STEPS": 4},
    "hybrid-mpc": {
        "SEEDS": (0,),
        "SPEEDS": (),
        "STAGES": (Stage(horizon=1, epochs=2), Stage(horizon=10, epochs=2)),
    },
    "joint-free-run": ONE | {"SAMPLES": 4_000},
    "lap": {"TRACKS": ("Norisring",), "TIMED": {"Norisring": (100, 2.0)}, "RANDOM": 1, "POINTS": 60},
    "loop": ONE | {"CALLS": 2},
    "magic-formula": ONE | {"BATCH": 1_000},
    "marx": ONE | {"MOMENTS": 6},
    "mpc": ONE | {"STEPS": 4},
    "n4sid": ONE | {"SAMPLES": 5_000, "FEWER": 2_000, "FEWEST": 1_000, "CHOICES": (500,)},
    "narx": ONE | {"SAMPLES": 20_000, "EPOCHS": 2},
    "plant": ONE | {"STEPS": 4_000, "CARS": 2},
    "racer": {"seeds": (0,), "laps": 1, "BENDS": (15.0, 25.0), "POINTS": 200},
    "real-cars": {},
    "rls": ONE | {"UPDATES": 500},
    "side-slip": {"PROCESS": (0.1,), "SENSOR": (1.5,), "LEARNED": (1.0,)},
    "training": ONE,
}
PUBLIC = ("adapt", "lap", "racer", "real-cars", "side-slip")  # on published data
COMPILED = ("compile", "driver", "driver-fleet", "driver-lap", "horizon", "hybrid-mpc", "loop", "marx", "mpc", "racer")


def smaller(name: str, module: Any, patch: pytest.MonkeyPatch) -> None:
    """What constants do not reach: fewer cars, planted mistakes, sizes of a problem, rows of a log, epochs."""
    if name == "training":
        patch.setattr(module, "CASES", (module.CASES[0]._replace(epochs=2),))
    if name == "adapt":
        cases = module.cases
        module.cases = lambda seconds: itertools.islice(cases(seconds), 2)
    if name == "driver":
        module.multi_body = SimpleNamespace(installed=lambda: False)  # the dual track alone
    if name == "driver-lap":  # a ring of 80 m in place of a race track
        angle = np.linspace(0.0, 2 * np.pi, 200)[:-1]
        ring = sa.Path.from_points(40.0 * np.cos(angle), 40.0 * np.sin(angle), closed=True)
        module.fetch = lambda *_: {"Norisring.csv": ring}
        module.Path = SimpleNamespace(from_csv=lambda track: track)
    if name == "driver-fleet":
        module.cars = lambda: ["1:10 car"]
    if name == "foreign-cars":
        module.MISTAKES = MISTAKES[:1]
        patch.setattr(judge, "MISTAKES", MISTAKES[:1])
    if name == "horizon":
        chain, race_car = module.chain, module.race_car
        module.chain, module.race_car = (lambda n: chain(10)), (lambda n: race_car(10))
    if name == "hybrid-mpc":
        log = module.log
        module.log = lambda: log(seconds=30.0)
    if name == "real-cars":
        (car,) = (car for car in module.CARS.values() if car.log == "dart")
        few = [sa.join(*log.experiments[:2]) for log in car.logs()]
        module.CARS = {"DART": SimpleNamespace(known=car.known, seen=("r only",), logs=lambda: few)}
    if name == "side-slip":
        public = module.public
        module.public = lambda of: public(of).head(12_000)


def test_every_benchmark_is_run_and_every_one_that_is_named_is_there():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    said = {word for line in re.findall(r"slipangle bench ([a-z0-9 -]+)", text) for word in line.split()}
    files = {name.replace("_", "-") for name in re.findall(r"benchmarks/bench_(\w+)\.py", text)}
    assert files <= set(benchmark_names())
    assert len(files) > 5
    assert len(said & SMALL.keys()) > 8
    assert sorted(SMALL) == benchmark_names()


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_a_benchmark_runs_to_its_end(name, request, monkeypatch):
    if name in PUBLIC:
        request.getfixturevalue("real_data")
    if name in COMPILED and compiler() is None:
        pytest.skip(sentence())
    module, given = find_benchmark(name), dict(SMALL[name])
    arguments = {key: given.pop(key) for key in list(given) if key.islower()}
    for constant, value in given.items():
        assert hasattr(module, constant)
        setattr(module, constant, value)
    smaller(name, module, monkeypatch)
    shares: list[float] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # with so little data much stays open, which is said
        outcome = module.bench(lambda share, what: shares.append(share), **arguments)
    numbers = [record.here for record in outcome.records if not isinstance(record.here, str)]
    assert numbers
    assert np.isfinite(numbers).all(), [r for r in outcome.records if not isinstance(r.here, str)]
    assert outcome.title
    assert outcome.protocol
    assert all(0 <= share <= 1 for share in shares)
