"""Compilers and machines that exported C is tried on; a test skips, with the reason, where one is absent."""

import importlib.util
import os
import shutil
import subprocess
import sys
from functools import cache

import numpy as np
import pytest

from slipangle.codegen import compiler
from slipangle.export.drives import standard_drive
from slipangle.export.kinds import project_of

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion")
ZIG = (sys.executable, "-m", "ziglang", "cc")
WASI = """
import { WASI } from 'node:wasi'
import { readFile } from 'node:fs/promises'
const wasi = new WASI({ version: 'preview1', args: process.argv.slice(2), env: {}, returnOnExit: true })
const made = await WebAssembly.compile(await readFile(process.argv[2]))
process.exitCode = wasi.start(await WebAssembly.instantiate(made, wasi.getImportObject()))
"""
PACKAGES = {  # of Debian
    "gcc": "gcc",
    "clang": "clang",
    "wine": "wine",
    "node": "nodejs",
    "qemu-arm": "qemu-user",
    "qemu-aarch64": "qemu-user",
    "arm-none-eabi-gcc": "gcc-arm-none-eabi",
    "arm-linux-gnueabihf-gcc": "gcc-arm-linux-gnueabihf",
    "aarch64-linux-gnu-gcc": "gcc-aarch64-linux-gnu",
    "cmake": "cmake",
    "g++": "g++",
    "cppcheck": "cppcheck",
    "clang-tidy": "clang-tidy",
    "valgrind": "valgrind",
    "size": "binutils",
    "nm": "binutils",
}


def needs(*tools):
    """Skip unless all these are installed, and a compiler for the drives that exported code repeats."""
    if compiler.compiler() is None:
        pytest.skip(compiler.sentence())
    for tool in tools:
        if tool == "zig":
            if importlib.util.find_spec("ziglang") is None:
                pytest.skip("ziglang is not installed: pip install --group export")
        elif shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed: apt-get install {PACKAGES.get(tool, tool)}")
    if "wine" in tools:
        boot_wine()


@cache
def boot_wine():
    """Wine makes its folder at the first start, which takes as long as it takes, not as a program may."""
    subprocess.run(["wine", "wineboot", "--init"], stdin=subprocess.DEVNULL, capture_output=True, check=False)


def run(*command, folder, stdin=None, environment=None, limit=240):
    """Standard output of a command that must succeed."""
    with open(stdin or os.devnull) as given:
        done = subprocess.run(
            [str(c) for c in command],
            cwd=folder,
            stdin=given,
            capture_output=True,
            text=True,
            timeout=limit,
            check=False,
            env={**os.environ, **(environment or {})},
        )
    assert done.returncode == 0, (command, done.stdout[-2000:], done.stderr[-3000:])
    return done.stdout


@cache
def machine(name):
    """Compiler with its flags, suffix of what it makes, and what runs that."""
    wasi = ("node", "--no-warnings", "wasi.mjs")
    return {
        "gcc": (("gcc", "-O2", "-march=native"), "", (), ("gcc",)),
        "gcc without SIMD": (
            ("gcc", "-O2", *(f"-DCAR{p}_LANES=1" for p in ("", "_WINDOW", "_JOINED", "_CALM", "_LIMIT"))),
            "",
            (),
            ("gcc",),
        ),
        "clang": (("clang", "-O2", "-march=native"), "", (), ("clang",)),
        "Windows": ((*ZIG, "-target", "x86_64-windows-gnu", "-O2"), ".exe", ("wine",), ("zig", "wine")),
        "Cortex-A53": (
            ("aarch64-linux-gnu-gcc", "-mcpu=cortex-a53", "-O2", "-static"),
            "",
            ("qemu-aarch64",),
            ("aarch64-linux-gnu-gcc", "qemu-aarch64"),
        ),
        "aarch64 Linux by Zig": (
            (*ZIG, "-target", "aarch64-linux-musl", "-O2"),
            "",
            ("qemu-aarch64",),
            ("zig", "qemu-aarch64"),
        ),
        "arm Linux by Zig": ((*ZIG, "-target", "arm-linux-musleabihf", "-O2"), "", ("qemu-arm",), ("zig", "qemu-arm")),
        "arm Linux": (
            ("arm-linux-gnueabihf-gcc", "-O2", "-static"),
            "",
            ("qemu-arm",),
            ("arm-linux-gnueabihf-gcc", "qemu-arm"),
        ),
        "WebAssembly": ((*ZIG, "-target", "wasm32-wasi", "-O2"), ".wasm", wasi, ("zig", "node")),
    }[name]


MACHINES = (
    "gcc",
    "gcc without SIMD",
    "clang",
    "Windows",
    "Cortex-A53",
    "aarch64 Linux by Zig",
    "arm Linux by Zig",
    "arm Linux",
    "WebAssembly",
)


def built_and_run(name, sources, folder, *words, stdin=None):
    """Standard output of a program, compiled for a machine and run as on it."""
    command, suffix, runner, tools = machine(name)
    needs(*tools)
    out = f"program{suffix}"
    run(*command, "-std=c99", "-o", out, *sources, "-lm", folder=folder)
    if name == "WebAssembly":
        (folder / "wasi.mjs").write_text(WASI)
    started = [*runner, out] if runner else [f"./{out}"]
    home = {"WINEDEBUG": "-all", "WINEPREFIX": str(folder / "wine")} if runner == ("wine",) else {}
    return run(*started, *words, folder=folder, stdin=stdin, environment=home)


def driven_on(name, controller, folder, steps=2000):
    """The first command of each step of a drive: what the C says on a machine, and what Python decided."""
    drive = standard_drive(controller, steps)
    project = project_of(controller, "car", drive)
    for file, content in project.everything.items():
        (folder / file).write_text(content)
    said = built_and_run(name, [*project.sources, "main.c"], folder, "--commands", stdin=folder / "drive.csv")
    assert np.abs(drive.commands).max() > 0.02
    commands = np.array(said.split(), dtype=float)
    assert commands.shape == (steps,)
    return commands, drive.commands[:, 0]


def repeated_on(name, made, folder):
    """Commands of the recorded drive of a driver: what its C says on a machine, and what was recorded."""
    for file, content in made.everything.items():
        (folder / file).write_text(content)
    said = built_and_run(name, [*made.sources, "main.c"], folder, "--commands", stdin=folder / "drive.csv")
    rows = np.array([line.split(",") for line in said.split()], dtype=float)
    wanted = np.loadtxt(folder / "drive.csv", delimiter=",", skiprows=1)[:, -rows.shape[1] :]
    assert rows.shape == wanted.shape
    return rows, wanted
