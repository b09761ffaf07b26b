"""C of an `EKF` or an `MHE`: its step written out, its settings as constants, and the loop around them."""

from __future__ import annotations

import casadi as ca
import numpy as np

from slipangle.codegen.expression import emit, preamble, scalar_code
from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.estimate.ekf import EKF
from slipangle.estimate.filter import Scales, filter_step
from slipangle.estimate.measurements import OPEN, headings
from slipangle.estimate.moving_horizon import MHE
from slipangle.export.controllers import table
from slipangle.export.meanings import meaning, parameters
from slipangle.export.memory import size_of
from slipangle.export.models import free_run
from slipangle.export.names import comment, constants
from slipangle.export.project import Project, replay, template
from slipangle.export.windows import window_solver, window_tables
from slipangle.models.repeated import Repeated
from slipangle.optimal.realtime.backend import FLAGS

EXACT = """\
#if defined __clang__
#pragma STDC FP_CONTRACT OFF
#elif defined __GNUC__
#pragma GCC optimize "fp-contract=off"
#endif
"""  # so that sums are those of Python


def filter_source(estimator: EKF, **functions: ca.Function | Repeated) -> str:
    """C of ``filter_begin`` and ``filter_take``, and of other functions by their names in C.

    Raises ParameterError if a function is none of scalar operations.
    """
    tracker = estimator.start_at()
    model, size = estimator.model, len(tracker._z)
    late = [round(estimator.late.get(n, 0.0) / estimator.dt) for n in model.outputs]
    numbers = {"NX": model.n_states, "NZ": size, "NU": model.n_inputs, "NY": model.n_outputs, "DEEPEST": max(late)}
    numbers |= {"PATIENCE": estimator.patience}
    gate = OPEN if estimator.gate is None else float(estimator.gate**2)
    lines = [f"#define {n} {v}" for n, v in numbers.items()]
    lines += [f"#define GATE ({'INFINITY' if gate == OPEN else repr(gate)})", table("AT_START", tracker._P)]
    lines.append(table("HEADINGS", headings(model), "int"))
    looking_back = isinstance(estimator, MHE)
    lines += [table("LATE", late, "int")] if any(late) or functions or looking_back else []
    functions = {"filter_step": filter_step(estimator, Scales(estimator)), **functions}
    if looking_back:
        functions["look"] = estimator.window.look
        lines += window_tables(estimator)
    written = [_written(f, name) for name, f in functions.items()]
    past, again = map(template, ("window_past.c", "filter_window.c") if looking_back else ("past.c", "filter_late.c"))
    code = template("filter.c").replace("@PAST@", past).replace("@AGAIN@", again)
    return "\n".join([EXACT, "#include <string.h>", preamble("double"), *written, *lines, code])


def _written(function: ca.Function | Repeated, name: str) -> str:
    """C of the function as scalar operations; raises ParameterError if it is none."""
    if isinstance(function, Repeated):
        return "\n".join(function.code(name, "double", emit))
    plain = scalar_code(function)
    if plain is None:
        raise ParameterError(
            "the estimator's model steps by an implicit method, which has no C inside a filter; expected one of "
            'explicit steps: take method="rk4"'
        )
    return emit(plain, name)


def estimator_project(estimator: EKF, name: str, data: Dataset | int) -> Project:
    """The files of an estimator.

    Parameters
    ----------
    estimator : EKF
        What is exported.
    name : str
        The project's name, checked.
    data : Dataset or int
        The record to be replayed, or so many samples of the model's own, noisy, from a car that steers in waves.

    Raises
    ------
    ParameterError
        If there is no C of it.
    """
    model, scales = estimator.model, Scales(estimator)
    if type(estimator).begin not in (EKF.begin, MHE.begin) or not (model.n_inputs and model.n_outputs):
        raise ParameterError(
            f"a {type(estimator).__name__} of {model.n_inputs} inputs, {model.n_outputs} outputs has no C; expected an "
            "EKF or an MHE of a model with both"
        )
    start, rows = replayed(estimator, data)
    back = estimator if isinstance(estimator, MHE) else None
    way = f"moving horizon estimator, {back.horizon} steps back," if back else "extended Kalman filter"
    title = f"{way} of {model.n_states} states, a sample every {model.dt:g} s"
    parts = [filter_source(estimator)]
    if estimator.free:
        parts += [table("PARAMETERS", scales.start), table("POSITIVE", scales.positive, "int")]
    source = "\n".join([*parts, template("estimator.c")])
    header = _header(estimator, title, start)
    bytes_ = size_of(f"{header}\n{source}", "Estimator", 1)
    solver = window_solver(back) if back else None
    window, sizes = (solver.files, solver.sizes) if solver else ({}, {1: 0})
    counts = (("y", model.n_outputs), ("u", model.n_inputs), ("x", model.n_states))
    columns = [f"{kind} {i}" for kind, n in counts for i in range(n)]
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows.tolist())]
    listed = {"states": model.states, "outputs": model.outputs, "inputs": model.inputs}
    listed |= {"parameters": estimator.free, "offsets": tuple(estimator.bias_std)}
    about = [f"- {what}: {', '.join(comment(n) for n in names) or 'none'}" for what, names in listed.items()]
    return Project(
        name=name,
        kind="estimator",
        sentence=f"{'A' if back else 'An'} {comment(title)}.",
        files={
            "car.h": header.replace("@BYTES@", str(bytes_)),
            "car.hpp": template("estimator.hpp"),
            "car.c": f'#include "car.h"\n{source}',
            **window,
            "car_block.h": template("estimator_block.h"),
            "main.c": replay("estimator_main.c"),
        },
        sources=("car.c", *(n for n in window if n.endswith(".c"))),
        drive="\n".join(lines) + "\n",
        about="\n".join([*about, f"- memory: {bytes_ + max(sizes.values())} bytes{' at most' if back else ''}"]),
        flags=FLAGS if back else (),
        readme="ESTIMATOR.md",
        facts={"dt": float(model.dt), "drive": {"steps": len(rows)}},
    )


def _header(estimator: EKF, title: str, start: np.ndarray) -> str:
    """The text of ``car.h`` but for the size of its memory."""
    model = estimator.model
    names = {"STATES": model.states, "OUTPUTS": model.outputs, "INPUTS": model.inputs}
    names |= {"PARAMETERS": estimator.free, "BIASES": tuple(estimator.bias_std)}
    counts = {k: len(v) for k, v in names.items()} | {"INPUTS_SIZE": max(model.n_inputs, 1)}
    text = template("estimator.h").replace("@TITLE@", comment(title)).replace("@DT@", repr(float(model.dt)))
    text = text.replace("@COUNTS@", "\n".join(f"#define CAR_{k} {v}" for k, v in counts.items()))
    back = isinstance(estimator, MHE)
    text = text.replace("@INCLUDED@", '\n#include "car_window.h"\n' if back else "")
    text = text.replace("@WINDOW@", "    car_window window;\n" if back else "")
    failed = "    int64_t failures; /* windows without a solution since car_start; a filter through them stands in */\n"
    text = text.replace("@FAILURES@", failed if back else "")
    text = text.replace("@START@", ", ".join(repr(float(v)) for v in start))
    own = {**parameters(model), **model.quantities}
    for letter, (mark, listed) in zip("XYUPB", names.items(), strict=True):
        made = constants(f"CAR_{letter}", listed).items()
        noise = heard(estimator) if mark == "OUTPUTS" else {}
        lines = [f"#define {c} {i} /* {meaning(n, own)}{noise.get(n, '')} */" for i, (n, c) in enumerate(made)]
        text = text.replace(f"@{mark}@", "\n".join(lines) or "/* none */")
    return text


def heard(estimator: EKF) -> dict[str, str]:
    """Of each output the standard deviation of its noise and how late it is, for a comment."""
    late = {n: f", {1e3 * s:.6g} ms late" for n, s in estimator.late.items() if s > 0}
    return {n: f", {estimator.noise(n):.6g}{late.get(n, '')}" for n in estimator.model.outputs}


def replayed(estimator: EKF, data: Dataset | int) -> tuple[np.ndarray, np.ndarray]:
    """State expected first, and a row of outputs, inputs and the state after them a sample."""
    model = estimator.model
    if isinstance(data, Dataset):
        data.require_dt(model.dt)
        part = data.experiments[0].select(inputs=model.inputs, outputs=model.outputs)
        start, y, u = np.asarray(model.initial_state(part.head(model.memory))), part.y, part.u
    else:
        start, rows = free_run(model, data)
        u, y = np.split(rows[:, model.n_states :], [model.n_inputs], axis=1)
        rng = np.random.default_rng(0)
        y = y + rng.normal(0.0, [estimator.noise(n) for n in model.outputs], y.shape)
        y[rng.uniform(size=y.shape) < 0.1] = np.nan
    tracker, kept = estimator.start_at(start), []
    for now, given in zip(y, u, strict=True):
        tracker.update(now, given)
        kept.append(np.concatenate([now, given, tracker.state]))
    return start, np.array(kept)
