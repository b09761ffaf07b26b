"""C of a `Model`: its step, output and correction, and a recorded free run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.expression import MOST_INSTRUCTIONS, emit, preamble, scalar_code
from slipangle.data.channels import STANDARD
from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.export.meanings import meaning
from slipangle.export.names import comment, constants
from slipangle.export.project import Project, template
from slipangle.models.model import Model
from slipangle.models.repeated import Repeated, repeated
from slipangle.units import SI

PARTS = ("step", "output", "correct")
_QUIET = """\
#if defined __GNUC__ || defined __clang__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#pragma GCC diagnostic ignored "-Wunused-function"
#pragma GCC diagnostic ignored "-Wconversion"
#pragma GCC diagnostic ignored "-Wsign-conversion"
#pragma GCC diagnostic ignored "-Wsign-compare"
#endif
"""


def model_source(model: Model) -> str:
    """C of ``car_step``, ``car_output`` and ``car_correct``, which begins after its header.

    Parameters
    ----------
    model : Model
        Any model: what is written out operation by operation, else CasADi's own code with its loops and solvers.
    """
    given = (("x", "u"), ("x", "u"), ("x", "u", "y"))
    functions = (step_function(model), *model.functions[1:])
    listed = zip(PARTS, functions, given, ("next", "y", "corrected"), strict=True)
    return sourced(
        [(f"void car_{n}", f, [f"{a}[{_SIZES[a]}]" for a in g], f"{r}[{_SIZES[r]}]") for n, f, g, r in listed]
    )


def step_function(model: Model) -> ca.Function | Repeated:
    """The model's step, of whose many explicit steps one is repeated where that is shorter."""
    step = model.functions[0]
    x, u = ca.SX.sym("x", model.n_states), ca.SX.sym("u", model.n_inputs)
    steps = repeated(model, x, u, given=[x, u]) if step.is_a("SXFunction") else None
    return steps if steps is not None and steps.shorter(scalar_code(step)) else step


def sourced(functions: Sequence[tuple[str, ca.Function | Repeated, Sequence[str], str]]) -> str:
    """C of CasADi functions, with its preamble.

    Parameters
    ----------
    functions : sequence of (str, Function or Repeated, sequence of str, str)
        Each with its type and name, ``void car_step``, and its arguments and its result with their sizes, ``x[4]``;
        the result's memory is zero where the function has structural zeros.
    """
    code, called, calls = [_SPOIL], [], []
    for declared, function, arguments, result in functions:
        name = declared.rpartition(" ")[2].rpartition("_")[2].title()
        names = [word.partition("[")[0] for word in (*arguments, result)]
        plain = None if isinstance(function, Repeated) else scalar_code(function)
        if isinstance(function, Repeated):
            code += function.code(f"plain{name}", "double", emit)
            call = f"    plain{name}({', '.join(names)});"
        elif plain is not None and plain.n_instructions() <= MOST_INSTRUCTIONS:
            code.append(emit(plain, f"plain{name}"))
            call = f"    plain{name}({', '.join(names)});"
        else:
            called.append(_wide(function, f"car_wide{name}"))
            call = _call(called[-1], tuple(names[:-1]), names[-1])
        listed = ", ".join([*(f"const double {a}" for a in arguments), f"double {result}"])
        whole = function.whole("whole") if isinstance(function, Repeated) else function
        tables, spoils = _spoils(whole, name, names[:-1], names[-1])
        calls.append(f"{tables}{declared}({listed})\n{{\n{call}\n{spoils}}}\n")
    own = [_QUIET, _casadi(called)] if called else []
    return "\n".join([*own, preamble("double"), *code, *calls])


_SPOIL = """\
/* What hangs on a number that is not finite is none: minima, maxima and signs would drop it. */
static void spoil(const double *given, const int *hangs, int many, double *result)
{
    for (int k = 0; k < many; k++) {
        double none = given[hangs[2 * k]] - given[hangs[2 * k]];
        if (!(none == 0))
            result[hangs[2 * k + 1]] = none;
    }
}
"""


def _spoils(function: ca.Function, name: str, arguments: Sequence[str], result: str) -> tuple[str, str]:
    """Tables of what of the result hangs on which argument, and the statements that go by them."""
    tables, statements = "", ""
    for i, argument in enumerate(arguments):
        rows, columns = function.jac_sparsity(0, i).get_triplet()
        if rows:
            pairs = ", ".join(f"{column}, {row}" for row, column in zip(rows, columns, strict=True))
            tables += f"static const int hangs{name}{argument.title()}[] = {{{pairs}}};\n"
            statements += f"    spoil({argument}, hangs{name}{argument.title()}, {len(rows)}, {result});\n"
    return tables, statements


_SIZES = {"x": "CAR_STATES", "next": "CAR_STATES", "corrected": "CAR_STATES", "u": "CAR_INPUTS_SIZE"}
_SIZES |= {"y": "CAR_OUTPUTS"}


def _wide(function: ca.Function, name: str) -> ca.Function:
    """The function under another name, dense."""
    given = [ca.MX.sym(function.name_in(i), function.size1_in(i)) for i in range(function.n_in())]
    return ca.Function(name, given, [ca.densify(function(*given))])


def _casadi(functions: list[ca.Function]) -> str:
    """Their C, all of whose names a project's own precedes, so that several go into one program."""
    generator = ca.CodeGenerator("car_wide", {"with_header": False, "verbose": False})
    for function in functions:
        generator.add(function)
    return generator.dump()


def _call(function: ca.Function, arguments: tuple[str, ...], result: str) -> str:
    """Statements that call CasADi's code with memory of its own on the stack."""
    listed = "\n".join(f"    in[{i}] = {a};" for i, a in enumerate(arguments))
    return f"""\
    const double *in[{max(function.sz_arg(), 1)}];
    double *out[{max(function.sz_res(), 1)}], work[{max(function.sz_w(), 1)}];
    casadi_int whole[{max(function.sz_iw(), 1)}];
{listed}
    out[0] = {result};
    {function.name()}(in, out, whole, work, 0);"""


def model_project(model: Model, name: str, data: Dataset | int) -> Project:
    """The files of a model.

    Parameters
    ----------
    model : Model
        What is exported.
    name : str
        The project's name, checked.
    data : Dataset or int
        The inputs of the recorded free run and its start, or so many samples of waves.

    Raises
    ------
    ParameterError
        If the model has no states.
    """
    if not model.n_states:
        raise ParameterError("the model has no states; expected a dynamic one: nothing is to be stepped")
    start, rows = free_run(model, data)
    title = f"{type(model).__name__} of {model.n_states} states, a step every {model.dt:g} s"
    columns = [f"{kind} {i}" for kind, n in zip("xuy", _counts(model), strict=True) for i in range(n)]
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows.tolist())]
    listed = zip(("states", "inputs", "outputs"), (model.states, model.inputs, model.outputs), strict=True)
    return Project(
        name=name,
        kind="model",
        sentence=f"A {comment(title)}.",
        files={
            "car.h": header(model, title, start),
            "car.hpp": template("model.hpp"),
            "car.c": f'#include "car.h"\n{model_source(model)}',
            "car_block.h": _block(start),
            "main.c": template("model_main.c"),
        },
        drive="\n".join(lines) + "\n",
        about="\n".join(f"- {what}: {', '.join(comment(n) for n in names) or 'none'}" for what, names in listed),
        facts={"model": type(model).__name__, "dt": float(model.dt), "drive": {"steps": len(rows)}},
        readme="MODEL.md",
    )


def _block(start: np.ndarray) -> str:
    return template("model_block.h").replace("@START@", ", ".join(float.hex(float(v)) for v in start))


def _counts(model: Model) -> tuple[int, int, int]:
    return model.n_states, model.n_inputs, model.n_outputs


def header(model: Model, title: str, start: np.ndarray) -> str:
    """The text of ``car.h``; ``start``, shape (n_states,), is the state at the start of the recorded free run."""
    n_states, n_inputs, n_outputs = _counts(model)
    counts = {"STATES": n_states, "INPUTS": n_inputs, "INPUTS_SIZE": max(n_inputs, 1), "OUTPUTS": n_outputs}
    text = template("model.h").replace("@TITLE@", comment(title)).replace("@DT@", repr(float(model.dt)))
    text = text.replace("@COUNTS@", "\n".join(f"#define CAR_{k} {v}" for k, v in counts.items()))
    begins = [f", {v:.9g}" for v in start]
    for mark, letter, names, more in (
        ("@STATES@", "X", model.states, begins),
        ("@INPUTS@", "U", model.inputs, [""] * n_inputs),
        ("@OUTPUTS@", "Y", model.outputs, [""] * n_outputs),
    ):
        made = zip(constants(f"CAR_{letter}", names).items(), more, strict=True)
        lines = [f"#define {c} {i} /* {meaning(n, model.quantities)}{at} */" for i, ((n, c), at) in enumerate(made)]
        text = text.replace(mark, "\n".join(lines) or "/* none */")
    return text


def free_run(model: Model, data: Dataset | int) -> tuple[np.ndarray, np.ndarray]:
    """First state, and a row of state, inputs and outputs a sample."""
    step, output, _ = model.functions
    if isinstance(data, Dataset):
        model.check(data)
        part = data.experiments[0]
        first = model.memory - 1
        x = np.asarray(model.initial_state(part.head(model.memory).select(inputs=model.inputs, outputs=model.outputs)))
        u = part.columns(model.inputs)[first:]
    else:
        x = np.asarray(model.straight(SPEED), dtype=float)
        u = np.column_stack([_wave(n, j, data, model.dt) for j, n in enumerate(model.inputs)] or [np.empty((data, 0))])
    start, rows = x, []
    for now in u:
        rows.append(np.concatenate([x, now, np.asarray(output(x, now)).ravel()]))
        x = np.asarray(step(x, now)).ravel()
    kept = np.array(rows)
    good = np.isfinite(kept).all(axis=1)
    return start, kept if good.all() else kept[: max(int(np.argmin(good)), 1)]


SPEED = 20.0  # m/s


def _wave(name: str, j: int, samples: int, dt: float) -> np.ndarray:
    """A smooth input of a size that a car knows."""
    t = dt * np.arange(samples)
    shape = np.sin((0.7 + 0.3 * j) * t) + 0.5 * np.sin((1.9 + 0.2 * j) * t + j)
    known: Any = STANDARD.get(name, SI("-", name))
    sizes = {"rad": 0.02, "m/s": 1.0, "N m": 100.0, "Pa": 1e5}
    return (SPEED if name == "v_x" else 0.0) + sizes.get(known.unit, 0.1) * shape
