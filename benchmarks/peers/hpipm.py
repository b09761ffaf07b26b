"""HPIPM, which acados uses, as CasADi ships it, by its own interface in C."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi
import numpy as np
from benchmarks.peers.forms import NOWHERE, Form
from benchmarks.peers.programs import Program
from benchmarks.peers.solvers import TOLERANCE, Solver, solved

from slipangle.codegen.compiler import library, sentence

FOLDER = Path(casadi.__file__).parent


class Numbers(Form):
    """All of a program behind each other, as ``hpipm_solve`` takes it.

    The first state is known and left out. States are those before, followed by the inputs before where these count.
    """

    def __init__(self, programs: Any) -> None:
        super().__init__(programs)
        first = programs[0]
        n, self.nx, self.nu = len(first.A), first.A.shape[1], first.B.shape[2]
        self.horizon, before = n, slice(self.nx, self.nx + self.nu)
        counts = any((p.H[1:, before] != 0).any() or (p.rows[:, before] != 0).any() for p in programs)
        self.wide = self.nx + (self.nu if counts else 0)
        self.sizes = np.array([0] + n * [self.wide], dtype=np.int32)
        self.stage = first.stage
        self.of = [np.flatnonzero(first.stage == i) for i in range(n + 1)]
        self.ng = np.array([len(rows) for rows in self.of], dtype=np.int32)
        self.ns = np.array([self.soft[rows].sum() for rows in self.of], dtype=np.int32)
        found = [np.flatnonzero(self.soft[rows]) for rows in self.of]
        self.which = np.concatenate([*found, [0]]).astype(np.int32)
        self.inputs = np.arange(n * self.nu)

    def matrices(self, program: Program) -> np.ndarray:
        """Of one program."""
        p, n, nx, nu, wide = program, self.horizon, self.nx, self.nu, self.wide
        state, here, out = slice(wide), slice(nx + nu, nx + 2 * nu), []
        low, high = np.maximum(p.low, -NOWHERE), np.minimum(p.high, NOWHERE)
        start = np.concatenate([p.start, np.zeros(wide - nx)])
        for i in range(n + 1):
            H, g, rows, end = p.H[i], p.g[i], p.rows[self.of[i]], i == n
            if not end:
                A, B = np.zeros((wide, wide)), np.zeros((wide, nu))
                A[:nx, :nx], B[:nx], B[nx:] = p.A[i], p.B[i], np.eye(nu)[: wide - nx]
                b = np.concatenate([p.c[i], np.zeros(wide - nx)])
                out += [A, B, b] if i else [B, b + A @ start]
            S, C, lows, highs = H[here, state], rows[:, state], low[self.of[i]], high[self.of[i]]
            r = g[here]
            if i:
                out += [H[state, state]]
            else:
                r, lows, highs = r + S @ start, lows - C @ start, highs - C @ start
            if not end:
                out += [S] * (i > 0) + [H[here, here]]
            out += [g[state]] * (i > 0)
            if not end:
                out += [r, p.bounds[i, :, 0], p.bounds[i, :, 1]]
            out += [C] * (i > 0) + [rows[:, here]] * (not end) + [lows, highs]
            soft = self.of[i][self.soft[self.of[i]]]
            out += [p.square[soft], p.plain[soft]]
        return np.concatenate([np.asarray(a).ravel(order="F") for a in out])


class Hpipm(Solver):
    """Interior point with a Riccati factor; its warm start is not used. Stages are joined where that is faster."""

    name, form = "HPIPM, by stages", Numbers
    joined = 1

    def __init__(self, first: Any, form: Any) -> None:
        code = Path(__file__).with_name("hpipm.c").read_text(encoding="utf-8")
        flags = (
            f"-I{FOLDER / 'include'}",
            f"-L{FOLDER}",
            f"-Wl,--no-as-needed,-rpath,{FOLDER}",
            "-lhpipm",
            "-lblasfeo",
        )
        if not (FOLDER / "libhpipm.so").exists():
            raise ImportError("CasADi has no HPIPM here")
        loaded = library(code, name="hpipm", flags=flags)
        if loaded is None:
            raise ImportError(sentence())
        self._library, self._u = loaded, np.zeros(form.horizon * form.nu)
        self._kept = form.sizes, form.ng, form.ns, form.which
        sizes, ng, ns, which = (a.ctypes.data for a in self._kept)
        few = -(-form.horizon // self.joined)
        self._peer = loaded.hpipm_begin(form.horizon, few, form.nu, sizes, ng, ns, which, TOLERANCE)

    def solve(self, ready: Any) -> np.ndarray:
        """See `Solver`."""
        status = self._library.hpipm_solve(self._peer, ready.ctypes.data, self._u.ctypes.data)
        solved(status == 0, f"status {status}")
        return self._u


class HpipmJoined(Hpipm):
    """The same, five stages joined to one."""

    name, joined = "HPIPM, five stages in one", 5
