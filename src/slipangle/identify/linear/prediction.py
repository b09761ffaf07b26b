"""The prediction-error criterion of a linear state space and its exact derivatives."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from typing import Any, Self

import numpy as np
from scipy import linalg

from slipangle.data.dataset import Dataset
from slipangle.errors import TooShortError
from slipangle.identify.excitation import require_identifiable
from slipangle.identify.linear.poles import modulus, shrunk
from slipangle.identify.linear.predictor import Bank, Point, Triangles, Work, reduce_rows
from slipangle.numerics.least_squares import Factors, LevenbergMarquardt
from slipangle.numerics.linear_response import LTI

_MATRICES = ("A", "B", "C", "D", "K")


class PredictionCriterion:
    """Cost and its linearisation over the free entries of one point, initial states eliminated; settings of `PEM`."""

    def __init__(self, settings: Any, data: Dataset, work: Work | None = None) -> None:
        start = settings.start
        start.check(data)
        self.work = Work() if work is None else work
        self.settings, self.data = settings, data
        self.n, self.nu, self.ny = start.order, start.n_inputs, start.n_outputs
        self.inputs = [data.index(c) for c in start.inputs]
        self.outputs = [data.index(c) for c in start.outputs]
        self.prediction = settings.focus == "prediction"
        direct = settings.direct if settings.direct is not None else bool(np.any(start.D))
        self.free = self._matrices(direct)
        self.free += ("u_offset",) if settings.offsets in ("input", "both") else ()
        self.free += ("y_offset",) if settings.offsets in ("output", "both") else ()
        self.point = self._first(direct)
        self.n_theta = sum(getattr(self.point, k).size for k in self.free)
        chosen, self.n_rows = self.enough(data), data.n_samples * self.ny
        self.size = np.maximum(np.std(chosen.y, axis=0), 1e-300)
        self.level_size = {"u_offset": np.std(chosen.u, axis=0), "y_offset": self.size}
        self.level_weight = 0.0
        self.x0_weight = np.zeros(self.n)
        self.radius = np.inf  # that the predictor is held within
        given = settings.weights
        self.root = np.diag(1 / (self.size if isinstance(given, str) else np.array(given)))

    def enough(self, data: Dataset) -> Dataset:
        """The model's channels of data that determine all that is free."""
        chosen = data.select(inputs=self.settings.start.inputs, outputs=self.settings.start.outputs)
        require_identifiable(chosen, max(1, self._n_determined() // self.ny))
        if data.n_samples * self.ny <= self.n_theta + self.n * len(data.starts):
            raise TooShortError(
                f"'{data.name}' has {data.n_samples} samples of {self.ny} outputs for {self.n_theta} parameters and "
                f"{len(data.starts)} initial states; expected more samples: record longer or lower the order"
            )
        return chosen

    def over(self, data: Dataset) -> Self:
        """The same criterion over some of its experiments."""
        part = copy(self)
        part.data, part.n_rows = data, data.n_samples * self.ny
        return part

    def _matrices(self, direct: bool) -> tuple[str, ...]:
        """Which matrices have free entries."""
        return ("F", "G", "C") + (("D",) if direct else ()) + (("K",) if self.prediction else ())

    def _n_determined(self) -> int:
        """How many parameters the data must determine."""
        return self.n_theta - self.n**2

    def _first(self, direct: bool) -> Point:
        """The start, in a basis in which the states have unit covariance on these data."""
        start, data = self.settings.start, self.data
        A, B, C, D, K = (np.array(getattr(start, k)) for k in _MATRICES)
        D = D if direct else np.zeros_like(D)
        K = K if self.prediction else np.zeros_like(K)
        limit = self.settings.max_radius
        A = shrunk(A, limit) if limit is not None else A
        point = Point(
            F=A - K @ C,
            G=B - K @ D,
            C=C,
            D=D,
            K=K,
            u_offset=np.array(start.u_offset),
            y_offset=np.array(start.y_offset),
            x0=np.zeros((len(data.starts), self.n)),
        )
        if not self.prediction and limit is None and modulus(A) > 1.001 and not self._followed(point):
            point = replace(point, F=shrunk(A, 1.0))  # a free run from an unstable start only overflows
        power, count = np.zeros((self.n, self.n)), 0
        for u, y, _ in self._chunks():
            states = self._states(point, u, y, np.zeros(self.n))
            power, count = power + states.T @ states, count + len(states)
        value, vector = np.linalg.eigh(power / count)
        T = (vector / np.sqrt(np.maximum(value, 1e-12 * value[-1]))).T
        back = linalg.inv(T)
        return replace(point, F=T @ point.F @ back, G=T @ point.G, K=T @ point.K, C=point.C @ back)

    def _followed(self, point: Point) -> bool:
        """Whether free runs of the start, from initial states of its own, err less on these data than means would."""
        x0, data = self.settings.start.x0, self.data
        if x0 is None or x0.shape != point.x0.shape:
            return False
        errors = np.diag(self.moments(replace(point, x0=x0)))
        return bool(np.all(errors < data.n_samples * np.var(data.values[:, self.outputs], axis=0)))

    def _chunks(self, size: int = 1 << 15) -> Any:
        """Inputs and outputs piece by piece, with whether an experiment starts there."""
        for start, stop in zip(self.data.starts, self.data.stops, strict=True):
            for a in range(start, stop, size):
                rows = self.data.values[a : min(a + size, stop)]
                yield rows[:, self.inputs], rows[:, self.outputs], a == start

    def _driven(self, point: Point, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.hstack([u - point.u_offset, y - point.y_offset])

    def _system(self, point: Point, C: np.ndarray, D: np.ndarray) -> LTI:
        return LTI(A=point.F, B=np.hstack([point.G, point.K]), C=C, D=np.hstack([D, np.zeros((len(D), self.ny))]))

    def _states(self, point: Point, u: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        n = self.n
        return self._system(point, np.eye(n), np.zeros((n, self.nu))).respond(x, self._driven(point, u, y))[0]

    def moments(self, point: Point) -> np.ndarray:
        """Sum of the outer products of the errors, shape (ny, ny); infinite where the predictor blows up."""
        total = np.zeros((self.ny, self.ny))
        self.work.done += self.data.n_samples
        for error, _ in self.errors(point):
            with np.errstate(over="ignore", invalid="ignore"):
                total = total + error.T @ error
        return total if np.isfinite(total).all() else np.full_like(total, np.inf)

    def errors(self, point: Point) -> Iterator[tuple[np.ndarray, bool]]:
        """Errors piece by piece, with whether an experiment starts there."""
        experiment, state = -1, np.zeros(self.n)
        system = self._system(point, point.C, point.D)
        for u, y, first in self._chunks():
            if first:
                experiment += 1
                state = point.x0[experiment]
            predicted, state = system.respond(state, self._driven(point, u, y))
            yield y - point.y_offset - predicted, first

    def cost(self, point: Point) -> float:
        """Weighted sum of squared errors."""
        moments = self.moments(point)
        if not np.isfinite(moments).all():
            return np.inf
        held = np.sum(self._pull(point)[0] ** 2) + np.sum((self.x0_weight * point.x0) ** 2)
        return float(np.trace(self.root @ moments @ self.root.T) + held)

    def _pull(self, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Errors that keep both levels together from running away, and their derivative by the free entries.

        Beside an integrator, a level at rest means nothing: it is held within some ten standard deviations of the
        signal around its start, with a weight that no determined level feels.
        """
        if not {"u_offset", "y_offset"} <= set(self.free):
            return np.zeros(0), np.zeros((0, self.n_theta))
        errors, rows, at = [], [], 0
        for key in self.free:
            size = getattr(point, key).size
            if key in self.level_size:
                weight = self.level_weight / self.level_size[key]
                errors.append(weight * (getattr(self.point, key) - getattr(point, key)))
                wide = np.zeros((size, self.n_theta))
                wide[:, at : at + size] = np.diag(weight)
                rows.append(wide)
            at += size
        return np.concatenate(errors), np.vstack(rows)

    @property
    def step_work(self) -> int:
        """Work of one linearisation."""
        return self.data.n_samples * (1 + self.n + self.n_theta)

    # ---- derivatives -------------------------------------------------------------------------------------------

    def linearise(self, point: Point, moves: np.ndarray | None = None) -> tuple[Triangles, np.ndarray]:
        """Triangles of [x0, free moves | error] and the free moves themselves, shape (n_theta, n_moves)."""
        moves = self._moves(point) if moves is None else moves
        self.work.done += self.step_work
        work, experiment = Triangles(self.n, moves.shape[1]), -1

        def close() -> None:
            if self.x0_weight.any():
                hold = self.x0_weight * point.x0[experiment]
                work.add(np.hstack([np.diag(self.x0_weight), np.zeros((self.n, moves.shape[1])), -hold[:, None]]))
            work.close()

        for first, local, shared, error in self.rows(point, moves):
            if first:
                if experiment >= 0:
                    close()
                experiment += 1
            rows = np.concatenate([local, shared, error[:, :, None]], axis=2)
            work.add(rows.reshape(-1, rows.shape[2]))
        close()
        pull, by_theta = self._pull(point)
        if len(pull):
            work.shared = reduce_rows(np.vstack([work.shared, np.column_stack([by_theta @ moves, pull])]))
        return work, moves

    def rows(self, point: Point, moves: np.ndarray) -> Iterator[tuple[bool, np.ndarray, np.ndarray, np.ndarray]]:
        """Piece by piece: whether an experiment starts, derivatives by x0 and by the moves, weighted errors."""
        D = np.vstack([np.zeros((self.n, self.nu)), point.D])
        system = self._system(point, np.vstack([np.eye(self.n), point.C]), D)
        experiment, state, bank = -1, np.zeros(self.n), self._bank(point)
        for u, y, first in self._chunks(bank.chunk()):
            if first:
                experiment += 1
                state = point.x0[experiment]
                bank.restart()
            driven = self._driven(point, u, y)
            both, state = system.respond(state, driven)
            signals = np.hstack([both[:, : self.n], driven, np.ones((len(u), 1))])
            jacobian = self._jacobian(point, bank.respond(signals), signals)
            error = (driven[:, self.nu :] - both[:, self.n :]) @ self.root.T
            local = np.einsum("ab,kbi->kai", self.root, jacobian[:, :, : self.n])
            shared = np.einsum("ab,kbi->kai", self.root, jacobian[:, :, self.n :] @ moves)
            yield first, local, shared, error

    def _bank(self, point: Point) -> Bank:
        return Bank(point.F, point.C, self.n + self.nu + self.ny + 1)

    def _jacobian(self, point: Point, response: np.ndarray, signals: np.ndarray) -> np.ndarray:
        """Derivative of the predicted outputs by x0 and by the free entries, shape (n_samples, ny, n + n_theta)."""
        n_samples, ny, n, _ = response.shape
        nu, unit = self.nu, np.eye(ny)

        def straight(z: np.ndarray) -> np.ndarray:
            return (unit[:, :, None] * z[:, None, None, :]).reshape(n_samples, ny, -1)

        ones = response[..., n + nu + ny]
        parts = {
            "F": lambda: response[..., :n].reshape(n_samples, ny, -1),
            "G": lambda: response[..., n : n + nu].reshape(n_samples, ny, -1),
            "K": lambda: response[..., n + nu : n + nu + ny].reshape(n_samples, ny, -1),
            "C": lambda: straight(signals[:, :n]),
            "D": lambda: straight(signals[:, n : n + nu]),
            "u_offset": lambda: -(ones @ point.G) - point.D,
            "y_offset": lambda: unit - ones @ point.K,
        }
        return np.concatenate([response[..., -1], *(parts[k]() for k in self.free)], axis=2)

    def _moves(self, point: Point) -> np.ndarray:
        """Orthonormal directions of the free entries that are orthogonal to changes of the state's basis."""
        n, tangent = self.n, []
        for i in range(n):
            for j in range(n):
                X = np.zeros((n, n))
                X[i, j] = 1.0
                turn = {"F": X @ point.F - point.F @ X, "G": X @ point.G, "C": -point.C @ X, "K": X @ point.K}
                tangent.append(
                    np.concatenate([turn.get(k, np.zeros(getattr(point, k).shape)).ravel() for k in self.free])
                )
        q: Any = linalg.qr(np.array(tangent).T)[0]
        return q[:, n * n :]

    def moved(self, point: Point, theta: np.ndarray, x0: np.ndarray) -> Point:
        """The point after a step; poles beyond the limit are moved back onto it."""
        parts, at = {}, 0
        for key in self.free:
            old = getattr(point, key)
            parts[key] = old + theta[at : at + old.size].reshape(old.shape)
            at += old.size
        return self._within(replace(point, **parts, x0=point.x0 + x0))

    def _within(self, point: Point) -> Point:
        """The point with poles beyond their limit back on it, and those of the predictor where they are held."""
        limit = self.settings.max_radius
        if limit is not None:
            point = replace(point, F=shrunk(point.F + point.K @ point.C, limit) - point.K @ point.C)
        if self.radius == np.inf or modulus(point.F) <= self.radius:
            return point
        if limit is not None:  # without K the predictor has the model's poles
            point = replace(point, F=point.F + point.K @ point.C, K=np.zeros_like(point.K))
        return replace(point, F=shrunk(point.F, self.radius))

    # ---- solving -----------------------------------------------------------------------------------------------

    def solve(
        self, max_iterations: int, tolerance: float = 1e-10, damping: float = 1e-3, rough: bool = False
    ) -> tuple[Point, tuple[str, ...]]:
        """Rounds of Levenberg-Marquardt, the outputs' weights renewed in between.

        A step that lowers the cost by less than ``tolerance`` of it is the last; ``damping`` is that of the first.
        Where a ``rough`` solution will do, the first weights are of the start's errors, and may be a little off.
        """
        point, notes = self._within(self.point), ()
        reweigh = self.settings.weights == "residual" and (self.ny > 1)
        if rough and reweigh:
            point = self._with_initial_states(point)
            self.root = self._whitener(point) if np.isfinite(self.moments(point)).all() else self.root
        for round_ in range(4 if reweigh else 1):
            point, notes = self._descend(point, max_iterations, tolerance, damping)
            if not reweigh or self.work.used_up:
                break
            before = self.root
            self.root = self._whitener(point)
            ratio = np.linalg.svd(self.root @ np.linalg.inv(before), compute_uv=False)
            if (round_ or rough) and ratio[0] / ratio[-1] < (1.1 if rough else 1.01):
                break
        return point, notes

    def _whitener(self, point: Point) -> np.ndarray:
        noise = self.moments(point) / self.data.n_samples
        if not self.prediction:  # free-run errors are coloured: their correlation is not noise to exploit
            noise = np.diag(np.diag(noise))
        noise = noise + np.diag(1e-10 * np.diag(noise) + (1e-10 * self.size) ** 2)  # outputs may repeat each other
        return np.linalg.inv(np.linalg.cholesky(noise))

    def _descend(
        self, point: Point, max_iterations: int, tolerance: float, damping: float
    ) -> tuple[Point, tuple[str, ...]]:
        point = self._with_initial_states(point)
        self.level_weight = 0.0
        self.level_weight = 0.1 * np.sqrt(self.cost(point) / self.n_rows)

        def linearise(point: Point) -> Factors:
            work, moves = self.linearise(point)
            d = moves.shape[1]
            return work.shared[:d, :d], work.shared[:d, d], (work, moves)

        def move(point: Point, context: Any, eta: np.ndarray) -> Point:
            work, moves = context
            trial = self.moved(point, moves @ eta, work.solve_locals(eta))
            return self.projected(trial)

        search = LevenbergMarquardt(cost=self.cost, linearise=linearise, move=move, damping=damping)
        search.enough = lambda: self.work.used_up
        result = search.minimise(point, max_iterations=max_iterations, tolerance=tolerance)
        if result.converged:
            return result.point, ()
        note = f"the fit stopped at its limit of {max_iterations} steps; expected convergence: raise max_iterations"
        return result.point, (note,)

    def projected(self, point: Point) -> Point:
        """The point with what the prediction is linear in, given F and C, at its least squares.

        This variable projection (G. Golub, V. Pereyra, Inverse Problems 19, 2003) straightens the valleys in which
        steps over all entries together creep.
        """
        before, free, n_theta = self.cost(point), self.free, self.n_theta
        linear = {"G", "D", "K"}
        if not self.prediction and "u_offset" not in free:  # otherwise levels multiply K or G
            linear = {"G", "D", "y_offset"}
        if not np.isfinite(before):
            return point
        self.free = tuple(key for key in free if key in linear)
        self.n_theta = sum(getattr(point, key).size for key in self.free)
        try:
            work, moves = self.linearise(point, np.eye(self.n_theta))
            r, e = work.shared[: self.n_theta, : self.n_theta], work.shared[: self.n_theta, self.n_theta]
            norms = np.maximum(np.linalg.norm(r, axis=0), 1e-300)
            eta = np.linalg.lstsq(r / norms, e, rcond=1e-12)[0] / norms
            moved = self.moved(point, moves @ eta, work.solve_locals(eta))
        finally:
            self.free, self.n_theta = free, n_theta
        return moved if self.cost(moved) < before else point

    def _with_initial_states(self, point: Point) -> Point:
        work, moves = self.linearise(point)
        return replace(point, x0=point.x0 + work.solve_locals(np.zeros(moves.shape[1])))

    # ---- what is reported --------------------------------------------------------------------------------------

    def as_named(self, point: Point, moves: np.ndarray) -> np.ndarray:
        """Derivative of A, B (and the other free entries) by moves of F, G (and the others)."""
        sizes = [getattr(point, k).size for k in self.free]
        at = dict(zip(self.free, np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(int), strict=True))
        out, n, nu, ny = np.eye(sum(sizes)), self.n, self.nu, self.ny
        for i in range(n):
            for m in range(ny):
                for j in range(n):  # A = F + K C
                    out[at["F"] + i * n + j, at["C"] + m * n + j] += point.K[i, m]
                    if "K" in at:
                        out[at["F"] + i * n + j, at["K"] + i * ny + m] += point.C[m, j]
                for j in range(nu):  # B = G + K D
                    if "D" in at:
                        out[at["G"] + i * nu + j, at["D"] + m * nu + j] += point.K[i, m]
                    if "K" in at:
                        out[at["G"] + i * nu + j, at["K"] + i * ny + m] += point.D[m, j]
        return out @ moves

    def named(self, point: Point) -> tuple[tuple[str, ...], np.ndarray]:
        """Names and values of the free entries, with A and B in place of the predictor's matrices."""
        shown = {"F": ("A", point.F + point.K @ point.C), "G": ("B", point.G + point.K @ point.D)}
        names, values = [], []
        for key in self.free:
            name, value = shown.get(key, (key, getattr(point, key)))
            names += [name + "[" + ",".join(map(str, index)) + "]" for index in np.ndindex(value.shape)]
            values.append(value.ravel())
        return tuple(names), np.concatenate(values)
