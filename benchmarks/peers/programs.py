"""Quadratic programs of real-time iterations, taken from the compiled solver as it poses them, and its time for them.

A few functions behind the generated code stop it where its first quadratic program is posed. What they show is the
same program twice: by stages, with all derivatives, and condensed to the inputs. Inputs count as changes of the plan
before, shifted, in units of half their range.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np

from slipangle.codegen.compiler import library, sentence
from slipangle.control.mpc import MPC
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.backend import FLAGS
from slipangle.optimal.realtime.engine import CONTINUE, Memory, WorkArea
from slipangle.optimal.realtime.parts import input_scale, limit_rows, slack_of_rows
from slipangle.optimal.realtime.program import source
from slipangle.optimal.solution import Plan

Driven = tuple[np.ndarray, Reference, Plan | None, Plan]  # state, reference, plan before, plan
Drive = Callable[[MPC], Iterator[Driven]]

PLACES = {name: name for name in "A B next x u E D e LX LU l".split()}  # of what is shown, in the solver's memory
PLACES |= {name: f"qp.{name}" for name in "H C g lo hi".split()} | {"v": "qp.u"}
CODE = """
int shown_width(void) { return QL; }
void *shown_at(Work *s, int i)
{
    void *const at[] = {%s};
    return at[i];
}
/* As `rt_solve` up to its first quadratic program: how long that takes to condense, or to factor. */
int shown_pose(Work *s, double *took)
{
    s->qp.until = INFINITY;
    start(s);
    s->from = FROM;
    int good = linearise(s);
    s->from = 0;
    double begin = monotonic();
    int status = good ? pose(s, 1, 0) : NOT_FINITE;
    *took = monotonic() - begin;
    feed(s);
    return status;
}
int shown_solve(Work *s, double *took)
{
    double begin = monotonic();
    int status = solve_qp(s, 1);
    *took = monotonic() - begin;
    return status;
}
"""


@dataclass(frozen=True, eq=False)
class Program:
    """One quadratic program: least 1/2 z'H z + g'z over stages, z the states, inputs before and inputs of a stage.

    ``A``, ``B``, ``c`` lead from stage to stage, ``start`` is the first state; ``H`` (horizon + 1, nz, nz), ``g``
    (horizon + 1, nz). ``rows`` (n_rows, nz) of ``stage`` have limits ``low``, ``high``, for excess at the prices
    ``plain`` (infinite: hard) and, squared, half of ``square``; inputs have ``bounds`` (horizon, n_u, 2). The same
    condensed: ``dense_H``, ``dense_g``, ``dense_rows``, whose limits are ``dense_low``, ``dense_high``. ``answer`` is
    ours, (horizon, n_u).
    """

    A: np.ndarray
    B: np.ndarray
    c: np.ndarray
    start: np.ndarray
    H: np.ndarray
    g: np.ndarray
    rows: np.ndarray
    stage: np.ndarray
    low: np.ndarray
    high: np.ndarray
    plain: np.ndarray
    square: np.ndarray
    bounds: np.ndarray
    dense_H: np.ndarray
    dense_g: np.ndarray
    dense_rows: np.ndarray
    dense_low: np.ndarray
    dense_high: np.ndarray
    answer: np.ndarray

    def cost(self, v: np.ndarray) -> float:
        """Of inputs, what is over soft limits included."""
        v = v.ravel()
        value = self.dense_rows @ v
        over = np.maximum(np.maximum(value - self.dense_high, self.dense_low - value), 0.0)
        soft = np.isfinite(self.plain)
        paid = self.plain[soft] * over[soft] + 0.5 * self.square[soft] * over[soft] ** 2
        return float(0.5 * v @ self.dense_H @ v + self.dense_g @ v + paid.sum())


class Shown:
    """A controller's compiled solver, stopped at its quadratic programs; ``qp`` says how they are solved."""

    def __init__(self, mpc: MPC, qp: str) -> None:
        settings = RealTime(qp=qp)
        code = source(mpc.ocp, qp=qp) + CODE % ", ".join(f"s->{place}" for place in PLACES.values())
        loaded = library(code, name="mpc", flags=FLAGS)
        if loaded is None:
            raise ImportError(sentence())
        self.mpc, self.ocp, self._library = mpc, mpc.ocp, loaded
        self._area = WorkArea(mpc.ocp, loaded, settings, None)
        self._took = np.zeros(1)

    def pose(self, x: np.ndarray, applied: np.ndarray, reference: Reference, memory: Memory) -> float:
        """Pose the first quadratic program of a plan, from the memory of the one before; how long that takes. [s]"""
        area = self._area
        area._set(x, applied, reference)
        area._found[:] = memory.found
        area._fresh[0] = CONTINUE
        status = self._library.shown_pose(area._pointer, self._took.ctypes.data)
        if status != 0:
            raise ArithmeticError(f"the quadratic program cannot be posed: outcome {status}")
        return float(self._took[0])

    def solve(self) -> float:
        """Solve what is posed; how long that takes. [s]"""
        status = self._library.shown_solve(self._area._pointer, self._took.ctypes.data)
        if status != 0:
            raise ArithmeticError(f"the quadratic program has no answer: outcome {status}")
        return float(self._took[0])

    @property
    def answer(self) -> np.ndarray:
        """The inputs that solve the quadratic program, shape (horizon, n_u)."""
        return self._array("v", (self.ocp.horizon, len(self.ocp.controls)))

    def _array(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        where = self._library.shown_at(self._area._pointer, list(PLACES).index(name))
        block: Any = (ctypes.c_double * max(prod(shape), 1)).from_address(where)
        return np.array(np.frombuffer(block))[: prod(shape)].reshape(shape)

    def program(self) -> Program:
        """What is posed, and its answer, which is found on the way; of a solver that condenses."""
        ocp, area = self.ocp, self._area
        n, nx, nu, ne, nl = ocp.horizon, ocp.model.n_states, len(ocp.controls), len(ocp.tracked), len(ocp.limited)
        sizes = {"A": (n, nx, nx), "B": (n, nx, nu), "next": (n, nx), "x": (n + 1, nx), "u": (n, nu)}
        sizes |= {"E": (n + 1, ne, nx), "D": (n + 1, ne, nu), "e": (n + 1, ne)}
        sizes |= {"LX": (n + 1, nl, nx), "LU": (n + 1, nl, nu), "l": (n + 1, nl)}
        of = {name: self._array(name, shape) for name, shape in sizes.items()}
        scale, view, u = input_scale(ocp), area._view, of["u"]
        q, wr, ws = (view[name] for name in ("q", "wr", "ws"))
        before, here = slice(nx, nx + nu), slice(nx + nu, nx + 2 * nu)
        H, g = np.zeros((n + 1, nx + 2 * nu, nx + 2 * nu)), np.zeros((n + 1, nx + 2 * nu))
        applied = np.vstack([view["applied"], u[:-1]])
        for i in range(n + 1):
            J = np.zeros((ne, nx + 2 * nu))
            J[:, :nx], J[:, here if i < n else before] = of["E"][i], of["D"][i] * scale
            H[i] += J.T @ (q[i][:, None] * J)
            g[i] += J.T @ (q[i] * of["e"][i])
            if i < n:
                change = np.hstack([np.zeros((nu, nx)), -np.diag(scale) * (i > 0), np.diag(scale)])
                H[i] += change.T @ (ws[i][:, None] * change)
                g[i] += change.T @ (ws[i] * (u[i] - applied[i]))
                H[i, here, here] += np.diag(wr[i] * scale**2)
                g[i, here] += scale * wr[i] * (u[i] - view["r"][i])
        places = limit_rows(ocp)
        stage, which = np.array(places, dtype=int).reshape(-1, 2).T
        rows = np.zeros((len(places), nx + 2 * nu))
        for row, (i, k) in enumerate(places):
            rows[row, :nx], rows[row, here if i < n else before] = of["LX"][i, k], of["LU"][i, k] * scale
        value = of["l"][stage, which]
        limits = view["bounds"][stage, which] - value[:, None] if places else np.zeros((0, 2))
        plain, square = slack_of_rows(ocp)
        wide, many = self._library.shown_width(), len(places)
        if np.isfinite(ocp.step_bounds).any():
            raise NotImplementedError("rates")
        upper = np.triu(self._array("H", (n * nu, wide))[:, : n * nu])
        lo, hi = (self._array(name, (n * nu + many,))[n * nu :] for name in ("lo", "hi"))
        bounds = (ocp.input_bounds[None] - u[:, :, None]) / scale[:, None]
        posed = {
            "dense_H": upper + np.triu(upper, 1).T,
            "dense_g": self._array("g", (n * nu,)),
            "dense_rows": self._array("C", (many + 1, wide))[:many, : n * nu],
        }
        self.solve()
        return Program(
            A=of["A"],
            B=of["B"] * scale,
            c=of["next"] - of["x"][1:],
            start=view["x0"] - of["x"][0],
            H=H,
            g=g,
            rows=rows,
            stage=stage,
            low=limits[:, 0],
            high=limits[:, 1],
            plain=plain,
            square=square,
            bounds=bounds,
            dense_low=lo,
            dense_high=hi,
            answer=self.answer,
            **posed,
        )


@dataclass(frozen=True, eq=False)
class Situation:
    """What a plan is asked for: state, input applied, reference, what the plan before left, and the plan."""

    x: np.ndarray
    applied: np.ndarray
    reference: Reference
    memory: Memory
    plan: Plan


def situations(mpc: MPC, drive: Drive) -> list[Situation]:
    """Of a drive, those that plan from a plan before."""
    found = []
    mpc = replace(mpc, solver=RealTime())
    for x, reference, before, plan in drive(mpc):
        if before is None or before.age or plan.age:
            continue
        if isinstance(before.memory, Memory):
            unwound = mpc._unwound(reference, x)
            found.append(Situation(np.array(x), before.command, unwound, before.memory, plan))
    return found
