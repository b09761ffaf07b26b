"""What an exported controller or driver costs at most: instructions and stack of a step, size of code and data."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from slipangle.codegen import compiler
from slipangle.errors import ConfigError, ParameterError
from slipangle.export.loops import LOOPS
from slipangle.export.names import with_prefix
from slipangle.export.project import Project, template

STATES = 10_000
LIMIT = 3600.0  # s, of one measurement
_ALONE = ("", "_PLANNER", "_WINDOW", "_JOINED", "_PLANNER_JOINED", "_CALM", "_LIMIT")
FLAGS = ("-O2", *(f"-DCAR{part}_LANES=1" for part in _ALONE))  # as for a processor without vectors
_CALLS: Mapping[str, tuple[str, str]] = {
    "plan": (
        "car_plan",
        """\
#include <stddef.h>

#define HAS_INPUTS (CAR_HORIZON * CAR_CONTROLS)
#define COLUMNS ((int)(offsetof(car_input, applied_known) / sizeof(double)) - HAS_INPUTS)
#define COMMANDS CAR_CONTROLS
#define FIRST 0
static car_controller controller;
static car_input input;
static car_output output;

static void call(const double *row, long k, int cold)
{
    double *to = (double *)&input;
    int before = (int)(offsetof(car_input, inputs) / sizeof(double));
    if (cold)
        (void)car_start(&controller, sizeof controller);
    memcpy(to, row, sizeof(double) * (size_t)before);
    memcpy(input.applied, row + before, sizeof input.applied);
    input.applied_known = input.applied[0] == input.applied[0];
    (void)k;
    (void)car_plan(&controller, &input, &output);
}
""",
    ),
    "step": (
        "car_step",
        """\
#define COLUMNS (1 + CAR_CHANNELS)
#define COMMANDS CAR_COMMANDS
#define FIRST 1
static car_driver driver;
static car_measurements measured;
static car_commands commands;

static void call(const double *row, long k, int cold)
{
    if (cold)
        (void)car_start(&driver, sizeof driver);
    measured.t = CAR_DT * (double)k;
    memcpy(measured.value, row + 1, sizeof measured.value);
    (void)car_step(&driver, &measured, &commands);
}
""",
    ),
}


@dataclass(frozen=True, kw_only=True)
class Budget:
    """What a step takes at most over some hard states, on this kind of processor without vectors.

    Parameters
    ----------
    function : str
        Of the header, whose calls were counted.
    states : int
        How many calls.
    most, median : int
        Instructions of the longest and of the middle call.
    stack : int
        Bytes of stack that a call takes at most.
    code, data, memory : int
        Bytes of code, of constants and of the struct.
    processor, compiled : str
        Whose instructions they are, and by what.
    """

    function: str
    states: int
    most: int
    median: int
    stack: int
    code: int
    data: int
    memory: int
    processor: str
    compiled: str

    def table(self) -> str:
        """Rows of Markdown, with what was measured in a sentence."""
        rows = {
            "instructions, longest call": self.most,
            "instructions, middle call": self.median,
            "stack, bytes": self.stack,
            "code, bytes": self.code,
            "constants, bytes": self.data,
            "memory, bytes": self.memory,
        }
        listed = [f"| {what} | {n} |" for what, n in rows.items()]
        said = (
            f"`{self.function}` over {self.states} hard states: those of the recorded drive, off by up to three times "
            "what it varies by, a tenth of them from a cold start, a twentieth with a fault. Counted by Callgrind on "
            f"{self.processor}, without vectors ({self.compiled}); other processors need about as many instructions."
        )
        return "\n".join(["## Budget", "", said, "", "| what | number |", "|---|---|", *listed])


def measured(project: Project, states: int = STATES) -> Budget:
    """Compile a project and count.

    Parameters
    ----------
    project : Project
        Of a controller or a driver.
    states : int
        How many calls.

    Raises
    ------
    ConfigError
        If Valgrind, a compiler or ``size`` is missing, or the program does not run.
    ParameterError
        If the project is of another kind.
    """
    kind = "step" if project.kind in LOOPS else "plan" if "interface" in project.facts else ""
    if not kind:
        raise ParameterError(f"a {project.kind} has no budget; expected a controller or a driver: export those with it")
    if states < 1:
        raise ParameterError(f"the budget is of {states} states; expected one at least")
    command = _tools()
    function, call = (with_prefix(text, project.name) for text in _CALLS[kind])
    flags = tuple(with_prefix(flag, project.name) for flag in FLAGS)
    with tempfile.TemporaryDirectory(prefix="slipangle-budget-") as scratch:
        folder, everything = Path(scratch), project.everything
        code = with_prefix(template("budget.c"), project.name).replace("@CALL@", call)
        for name, text in {**everything, "budget.c": code}.items():
            (folder / name).write_text(text, encoding="utf-8")
        objects = []
        for source in (s.replace("car", project.name) for s in project.sources):
            objects.append(source.replace(".c", ".o"))
            _run(folder, *command, *flags, "-c", source, "-o", objects[-1])
        _run(folder, *command, *flags, "-pthread", "-Wl,-z,now", "budget.c", *objects, "-o", "budget", "-lm")
        stack = int(_run(folder, "./budget", "stack", str(states)))
        counts = _counted(folder, function, states)
        sizes = [list(map(int, row.split()[:3])) for row in _run(folder, "size", *objects).splitlines()[1:]]
        constants = [_constants(folder, name) for name in objects]
    code_bytes = sum(text for text, *_ in sizes) - sum(constants)
    return Budget(
        function=function,
        states=states,
        most=counts[-1],
        median=counts[len(counts) // 2],
        stack=stack,
        code=code_bytes,
        data=sum(constants) + sum(data + bss for _, data, bss in sizes),
        memory=_memory(project),
        processor=platform.machine(),
        compiled=" ".join((compiler.version(), *flags)),
    )


def _tools() -> tuple[str, ...]:
    """The compiler's command."""
    command = compiler.compiler()
    if command is None:
        raise ConfigError(f"{compiler.sentence().partition(',')[0]}; expected one to count what the code takes")
    for tool, package in (("valgrind", "valgrind"), ("size", "binutils"), ("objdump", "binutils")):
        if shutil.which(tool) is None:
            raise ConfigError(
                f"{tool} was not found; expected it to count what the code takes: apt-get install {package}"
            )
    return command


def _run(folder: Path, *command: str) -> str:
    with (folder / "drive.csv").open() as given:
        done = subprocess.run(
            command, cwd=folder, stdin=given, capture_output=True, text=True, timeout=LIMIT, check=False
        )
    if done.returncode:
        said = (done.stderr or done.stdout).strip().partition("\n")[0]
        raise ConfigError(f"'{command[0]}' ended with code {done.returncode} ({said[:200]}); expected it to count")
    return done.stdout


def _counted(folder: Path, function: str, states: int) -> list[int]:
    """Instructions of each call, rising."""
    tool = ("valgrind", "-q", "--tool=callgrind", "--dump-line=no", "--callgrind-out-file=counts")
    _run(folder, *tool, f"--toggle-collect={function}", f"--dump-after={function}", "./budget", "count", str(states))
    found = [re.search(r"^totals: (\d+)", p.read_text(errors="replace"), re.MULTILINE) for p in folder.glob("counts.*")]
    counts = sorted(int(m[1]) for m in found if m and int(m[1]))
    if len(counts) != states:
        raise ConfigError(f"Valgrind counted {len(counts)} calls of {states}; expected all: the compiler inlined it")
    return counts


def _constants(folder: Path, name: str) -> int:
    """Bytes of read-only data of an object."""
    rows = re.findall(r"^\s*\d+\s+(\.rodata\S*)\s+([0-9a-f]+)", _run(folder, "objdump", "-h", name), re.MULTILINE)
    return sum(int(size, 16) for _, size in rows)


def _memory(project: Project) -> int:
    return int(project.facts["bytes"][1])


def with_budget(project: Project, budget: Budget) -> dict[str, Any]:
    """What changes in a project that its budget is known of: ``about`` and ``facts``."""
    return {"about": f"{project.about}\n\n{budget.table()}", "facts": {**project.facts, "budget": asdict(budget)}}
