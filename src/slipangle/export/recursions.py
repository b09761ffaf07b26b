"""C of recursive least squares: one sample at a time, from the estimate that it has now."""

from __future__ import annotations

import numpy as np

from slipangle.codegen.expression import emit, preamble
from slipangle.data.dataset import Dataset
from slipangle.export.controllers import table
from slipangle.export.meanings import meaning
from slipangle.export.memory import size_of
from slipangle.export.names import comment, constants
from slipangle.export.project import Project, replay, template
from slipangle.identify.linear.recursive import RecursiveARX
from slipangle.identify.linear.recursive_code import LARGEST


def recursion_project(recursive: RecursiveARX, name: str, data: Dataset | int) -> Project:
    """The files of recursive least squares.

    Parameters
    ----------
    recursive : RecursiveARX
        What is exported, before the first sample of a new drive; its own goes on as if nothing had been.
    name : str
        The project's name, checked.
    data : Dataset or int
        The record to be replayed, or so many samples of a stable system of the same channels, noisy.
    """
    recursion, (n_y, n_u) = begun(recursive)._recursion, (len(recursive.outputs), len(recursive.inputs))
    labels = recursive.names[: len(recursive.names) // n_y]
    regressors = [label.partition(": ")[2] or label for label in labels] if n_y > 1 else list(labels)
    title = f"recursive least squares of {len(regressors)} regressors, a sample every {recursive.dt:g} s"
    counts = {"OUTPUTS": n_y, "INPUTS": n_u, "REGRESSORS": len(regressors), "LAGS": recursion.memory}
    header = template("recursion.h").replace("@TITLE@", comment(title)).replace("@DT@", repr(float(recursive.dt)))
    header = header.replace("@COUNTS@", "\n".join(f"#define CAR_{k} {v}" for k, v in counts.items()))
    for letter, mark, names in (
        ("Y", "OUTPUTS", recursive.outputs),
        ("U", "INPUTS", recursive.inputs),
        ("P", "REGRESSORS", regressors),
    ):
        lines = [
            f"#define {c} {i} /* {meaning(n, {})} */"
            for i, (n, c) in enumerate(constants(f"CAR_{letter}", names).items())
        ]
        header = header.replace(f"@{mark}@", "\n".join(lines))
    parts = [
        "#include <string.h>",
        preamble("double"),
        emit(recursion.function, "advance"),
        table("AT_START", recursion.state),
        table("SETTINGS", recursion.settings),
        f"#define N_STATE {recursion.state.size}",
        f"#define FILLED {recursion.place('filled')}",
        f"#define LARGEST {LARGEST:e}",
        template("recursion.c"),
    ]
    source = "\n".join(parts)
    bytes_ = size_of(f"{header}\n{source}", "Recursion", 1)
    rows = replayed(recursive, data)
    columns = [*(f"y {i}" for i in range(n_y)), *(f"u {i}" for i in range(n_u))]
    columns += [f"theta {i}" for i in range(rows.shape[1] - len(columns))]
    listed = {"outputs": recursive.outputs, "inputs": recursive.inputs, "regressors": regressors}
    about = [f"- {what}: {', '.join(comment(n) for n in names)}" for what, names in listed.items()]
    return Project(
        name=name,
        kind="recursion",
        sentence=f"A {comment(title)}.",
        files={
            "car.h": header.replace("@BYTES@", str(bytes_)),
            "car.hpp": template("recursion.hpp"),
            "car.c": f'#include "car.h"\n{source}',
            "car_block.h": template("recursion_block.h"),
            "main.c": replay("recursion_main.c"),
        },
        drive="\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n",
        about="\n".join([*about, f"- memory: {bytes_} bytes"]),
        readme="RECURSION.md",
        facts={"dt": float(recursive.dt), "drive": {"steps": len(rows)}},
    )


def begun(recursive: RecursiveARX) -> RecursiveARX:
    """A copy that knows as much, where a new drive begins."""
    made = RecursiveARX(recursive.settings, recursive.inputs, recursive.outputs, recursive.dt)
    made._recursion.state[:] = recursive._recursion.state
    made.restart()
    made._recursion.error[:] = 0.0
    return made


def replayed(recursive: RecursiveARX, data: Dataset | int) -> np.ndarray:
    """Rows of outputs, inputs and the coefficients after them, of a recursion that knows as much as this one.

    Raises SimulationError where the record holds what no channel reads.
    """
    if isinstance(data, Dataset):
        data.require_dt(recursive.dt)
        part = data.experiments[0].select(inputs=recursive.inputs, outputs=recursive.outputs)
        y, u = part.y, part.u
    else:
        rng = np.random.default_rng(0)
        u = rng.normal(size=(data, len(recursive.inputs)))
        y = np.zeros((data, len(recursive.outputs)))
        for k in range(1, data):
            y[k] = 0.8 * y[k - 1] + 0.3 * u[k - 1].sum() + 0.05 * rng.normal(size=y.shape[1])
    own, kept = begun(recursive), []
    for now, given in zip(y, u, strict=True):
        own.update(now, given)
        kept.append(np.concatenate([now, given, own.theta]))
    return np.array(kept)
