"""The quadratic program of MARX-MPC with NumPy and DAQP, where there is no compiler."""

from __future__ import annotations

from typing import Any

import daqp
import numpy as np

from slipangle.control.marx.problem import Answer, MarxProgram, Numbers, Offset, Solver
from slipangle.models.wrappers.multi_arx import speed_weights
from slipangle.optimal.solution import Status, within


class Interpreted(Solver):
    """The same with NumPy, the quadratic program by DAQP."""

    def __init__(self, problem: MarxProgram, numbers: Numbers) -> None:
        self._problem, self._numbers = problem, numbers

    def solve(
        self, x: np.ndarray, path: np.ndarray, v_x: np.ndarray, applied: float, numbers: Numbers | None, offset: Offset
    ) -> Answer:
        """See `Solver`."""
        p, n = self._problem, len(self._problem.knots)
        given = numbers or self._numbers
        x, v = np.asarray(x, dtype=float), np.asarray(v_x, dtype=float).ravel()
        if not all(np.isfinite(a).all() for a in (x, path, v)):
            return self._nothing(Status.NOT_FINITE)
        shape = "smooth" if p.smooth else "triangular"
        w = np.column_stack(speed_weights(np.append(v, v[-1]), given.speeds.tolist(), shape))  # a row per step
        free, hit = self._blend(x, w, given, offset)
        hit = hit @ p.shares
        pose, turned = self._on_ground(free, hit, v, applied) if p.posed else (None, None)
        rows, errors = self._track(x, path, free, hit, pose, turned)
        H = p.r * p.shares.T @ p.shares + p.s * p.changes.T @ p.changes
        g = np.zeros(n)
        g[0] = -p.s * applied
        fixed = p.s * applied**2
        for t in range(len(p.q)):
            weight = np.full(p.horizon + 1, p.q[t])
            weight[-1] = p.end[t]
            H += rows[t].T @ (weight[:, None] * rows[t])
            g += rows[t].T @ (weight * errors[t])
            fixed += float(weight @ errors[t] ** 2)
        change = np.eye(n) - np.eye(n, k=-1) if p.rated else np.zeros((0, n))
        base = np.zeros(len(change))
        base[:1] = applied
        most = 1e30  # what DAQP takes for infinite
        lasts = np.diff(p.knots, prepend=-1)[: len(change)]
        upper = np.clip(np.concatenate([np.full(n, p.bounds[1]), base + lasts * p.steps[1]]), -most, most)
        lower = np.clip(np.concatenate([np.full(n, p.bounds[0]), base + lasts * p.steps[0]]), -most, most)
        sense = np.zeros(n + len(change), dtype=np.int32)
        scale = 1.0 / max(float(np.trace(H)) / n, 1e-300)
        u, _, flag, info = daqp.solve(H * scale, g * scale, np.ascontiguousarray(change), upper, lower, sense)
        if flag < 1 or not np.isfinite(u).all():
            return self._nothing(Status.INFEASIBLE if flag == -1 else Status.FAILED)
        u = np.clip(u, *p.bounds)
        return Answer(
            Status.SOLVED,
            within((p.shares @ u)[:, None], np.array([applied]), p.bounds[None], p.steps[None]),
            self._states(x, u, free, hit, pose, turned),
            w[0],
            float(u @ H @ u + 2 * g @ u + fixed),
            int(info.get("iterations", 0)),
            float("nan"),
        )

    def _nothing(self, status: Status) -> Answer:
        p = self._problem
        empty = np.zeros((p.horizon + 1, p.n_states))
        return Answer(status, np.zeros((p.horizon, 1)), empty, np.zeros(p.n_models), float("nan"), 0, float("nan"))

    def _blend(
        self, x: np.ndarray, w: np.ndarray, given: Numbers, offset: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Blended outputs without input, (n + 1, ny), and by unit inputs, (n + 1, ny, n)."""
        p = self._problem
        n, ny, na = p.horizon, len(p.outputs), p.na
        free, hit = np.zeros((n + 1, ny)), np.zeros((n + 1, ny, n))
        free[0] = x[:ny]
        past_y, past_u = x[: na * ny].reshape(na, ny), x[na * ny : na * ny + p.reach - 1]
        for j in np.flatnonzero(w[1:].any(axis=0)):
            A, B, c = given.A[j], given.B[j], given.c[j] + offset
            runs = []
            for y0, u0, constant in (
                (past_y, np.concatenate([[0.0], past_u]), c),
                (np.zeros_like(past_y), np.eye(1, p.reach)[0], 0 * c),
            ):
                y, u = [row for row in y0[::-1]], u0
                for _ in range(n):
                    y.append(constant - sum(A[i] @ y[-1 - i] for i in range(na)) + u @ B)
                    u = np.concatenate([[0.0], u[:-1]])
                runs.append(np.array(y[na:]))
            free[1:] += w[1:, j, None] * runs[0]
            for k in range(n):
                hit[k + 1 :, :, k] += w[k + 1 :, j, None] * runs[1][: n - k]
        return free, hit

    def _on_ground(self, free: np.ndarray, hit: np.ndarray, v: np.ndarray, held: float) -> tuple[Any, Any]:
        """X, Y, psi in the vehicle's frame without input, (n + 1, 3), and by unit inputs, (n + 1, 3, n).

        Linear about the motion with the input held.
        """
        p, h = self._problem, self._problem.dt
        i, j = p.outputs.index("v_y"), p.outputs.index("r")
        pose, by = np.zeros((p.horizon + 1, 3)), np.zeros((p.horizon + 1, 3, hit.shape[2]))
        now = free + hit.sum(axis=2) * held
        for k in range(p.horizon):
            mean = pose[k, 2] + h * (2 * now[k, j] + now[k + 1, j]) / 6
            turned = by[k, 2] + h * (2 * hit[k, j] + hit[k + 1, j]) / 6
            v_y, slide = 0.5 * (now[k, i] + now[k + 1, i]), 0.5 * h * (hit[k, i] + hit[k + 1, i])
            c, s = np.cos(mean), np.sin(mean)
            move = h * np.array([v[k] * c - v_y * s, v[k] * s + v_y * c, 0.5 * (now[k, j] + now[k + 1, j])])
            pose[k + 1] = pose[k] + move
            by[k + 1, 0] = by[k, 0] - move[1] * turned - s * slide
            by[k + 1, 1] = by[k, 1] + move[0] * turned + c * slide
            by[k + 1, 2] = by[k, 2] + 0.5 * h * (hit[k, j] + hit[k + 1, j])
        return pose - by.sum(axis=2) * held, by

    def _track(self, x: Any, path: Any, free: Any, hit: Any, pose: Any, turned: Any) -> tuple[list, list]:
        """Rows and free errors of each tracked quantity."""
        if pose is None:
            return [hit[:, 0]], [free[:, 0] - path[:, 1]]
        here = x[-3:]
        c, s = np.cos(here[2]), np.sin(here[2])
        d = path[:, :2] - here[:2]
        along, across, angle = c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], path[:, 2] - here[2]
        c, s = np.cos(angle), np.sin(angle)
        e_y = c * (pose[:, 1] - across) - s * (pose[:, 0] - along)
        e_psi = pose[:, 2] - angle - 2 * np.pi * np.round(-angle[0] / (2 * np.pi))
        return [c[:, None] * turned[:, 1] - s[:, None] * turned[:, 0], turned[:, 2]], [e_y, e_psi]

    def _states(self, x: Any, u: Any, free: Any, hit: Any, pose: Any, turned: Any) -> np.ndarray:
        """The predicted states: lags filled with what was measured, predicted and decided."""
        p = self._problem
        n, ny, split = p.horizon, len(p.outputs), p.na * len(p.outputs)
        y = np.vstack([x[:split].reshape(p.na, ny)[:0:-1], free + hit @ u])
        inputs = np.concatenate([x[split : split + p.reach - 1][::-1], p.shares @ u])
        rows = []
        for i in range(n + 1):
            lags = y[i : i + p.na][::-1].ravel()
            rows.append(np.concatenate([lags, inputs[i : i + p.reach - 1][::-1], x[len(x) - 3 :] if p.posed else []]))
        out = np.array(rows)
        if p.posed:
            moved, c, s = pose + turned @ u, np.cos(x[-1]), np.sin(x[-1])
            out[:, -3:] += np.column_stack(
                [c * moved[:, 0] - s * moved[:, 1], s * moved[:, 0] + c * moved[:, 1], moved[:, 2]]
            )
        return out
