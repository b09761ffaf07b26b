"""Solvers of quadratic programs that pip installs, each set up once, then given one program after the other."""

from __future__ import annotations

import importlib
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from benchmarks.peers.forms import Condensed, Matrices, Stages

TOLERANCE = 1e-8  # of all, absolute and relative
NO_LIMIT = 1e20  # where infinity may not be said


class Solver:
    """One solver in one form; ``solve`` gives a program's new matrices and vectors to it, and its answer."""

    name: ClassVar[str]
    form: ClassVar[Any] = Stages

    def __init__(self, first: Any, form: Any) -> None:
        raise NotImplementedError

    def ready(self, program: Matrices) -> Any:
        """The program in the arrays that the solver takes; not timed."""
        return program

    def solve(self, ready: Any) -> np.ndarray:
        """The variables."""
        raise NotImplementedError


def solved(good: bool, said: Any) -> None:
    """Raise what a solver said, if that is no answer."""
    if not good:
        raise ArithmeticError(str(said))


class Osqp(Solver):
    """ADMM, warm started from the program before: its variables are changes, so zeros, and its multipliers."""

    name = "OSQP, sparse"

    def __init__(self, first: Any, form: Any) -> None:
        lib = importlib.import_module("osqp")
        P, q, A, low, high = self.ready(first)
        self._solver, self._zeros = lib.OSQP(), np.zeros(len(q))
        self._y = None
        self._solver.setup(
            P.copy(), q, A, low, high, eps_abs=TOLERANCE, eps_rel=TOLERANCE, max_iter=20_000, verbose=False,
            adaptive_rho_interval=25,
        )  # fmt: skip

    def ready(self, program: Matrices) -> Any:
        """See `Solver`."""
        A, low, high = program.joined()
        return sp.triu(sp.csc_matrix(program.P), format="csc"), program.q, sp.csc_matrix(A), low, high

    def solve(self, ready: Any) -> np.ndarray:
        """See `Solver`."""
        P, q, A, low, high = ready
        self._solver.update(q=q, l=low, u=high, Px=P.data, Ax=A.data)
        if self._y is not None:
            self._solver.warm_start(x=self._zeros, y=self._y)
        found = self._solver.solve()
        solved(found.info.status_val == 1, found.info.status)
        self._y = found.y
        return found.x


class OsqpCondensed(Osqp):
    """The same, on the inputs alone."""

    name, form = "OSQP, condensed", Condensed

    def ready(self, program: Matrices) -> Any:
        """See `Solver`."""
        A, low, high = _dense_joined(program)
        size = len(program.q)
        every = sp.csc_matrix(np.triu(np.ones((size, size))))
        P = sp.csc_matrix((program.P.T[np.tril_indices(size)], every.indices, every.indptr), (size, size))
        return P, program.q, _full(A), low, high


class Piqp(Solver):
    """Proximal interior point with a factor by stages; it has no warm start."""

    name = "PIQP, by stages"
    kkt = "sparse_multistage"

    def __init__(self, first: Any, form: Any) -> None:
        lib = importlib.import_module("piqp")
        self._solver = lib.DenseSolver() if self.form is Condensed else lib.SparseSolver()
        settings = self._solver.settings
        if self.form is not Condensed:
            settings.kkt_solver = getattr(lib.KKTSolver, self.kkt)
        settings.eps_abs, settings.eps_rel, settings.verbose = TOLERANCE, TOLERANCE, False
        settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = TOLERANCE, TOLERANCE
        self._good = lib.PIQP_SOLVED
        self._solver.setup(*self.ready(first))

    def ready(self, program: Matrices) -> Any:
        """See `Solver`."""
        m = program
        A, b = (m.A, m.b) if len(m.b) else (None, None)
        G, low, high = (m.G, m.low, m.high) if len(m.low) else (None, None, None)
        return m.P, m.q, A, b, G, low, high, m.bounds[:, 0].copy(), m.bounds[:, 1].copy()

    def solve(self, ready: Any) -> np.ndarray:
        """See `Solver`."""
        P, c, A, b, G, low, high, x_low, x_high = ready
        self._solver.update(P=P, c=c, A=A, b=b, G=G, h_l=low, h_u=high, x_l=x_low, x_u=x_high)
        status = self._solver.solve()
        solved(status == self._good, status)
        return self._solver.result.x


class PiqpCondensed(Piqp):
    """The same, dense."""

    name, form = "PIQP, condensed", Condensed


class Clarabel(Solver):
    """Homogeneous interior point; it has no warm start."""

    name = "Clarabel, sparse"

    def __init__(self, first: Any, form: Any) -> None:
        lib = importlib.import_module("clarabel")
        settings = lib.DefaultSettings()
        settings.verbose, settings.presolve_enable, settings.max_threads = False, False, 1
        settings.input_sparse_dropzeros = False
        settings.tol_gap_abs = settings.tol_feas = TOLERANCE
        settings.tol_gap_rel = TOLERANCE
        P, q, A, b, equal = self.ready(first)
        cones = [lib.ZeroConeT(equal), lib.NonnegativeConeT(len(b) - equal)]
        self._good = str(lib.SolverStatus.Solved)
        self._solver = lib.DefaultSolver(P, q, A, b, cones if equal else cones[1:], settings)

    def ready(self, program: Matrices) -> Any:
        """See `Solver`."""
        m, size = program, len(program.q)
        G = sp.vstack([sp.csc_matrix(m.G), sp.identity(size, format="csc")], format="csc")
        low, high = np.r_[m.low, m.bounds[:, 0]], np.r_[m.high, m.bounds[:, 1]]
        has_low, has_high = np.isfinite(low), np.isfinite(high)
        A = sp.vstack([sp.csc_matrix(m.A), G[has_high], -G[has_low]], format="csc")
        P = sp.triu(sp.csc_matrix(m.P), format="csc")
        return P, m.q, A, np.r_[m.b, high[has_high], -low[has_low]], len(m.b)

    def solve(self, ready: Any) -> np.ndarray:
        """See `Solver`."""
        P, q, A, b, _ = ready
        self._solver.update(P=P.data, q=q, A=A.data, b=b)
        found = self._solver.solve()
        solved(str(found.status) == self._good, found.status)
        return np.asarray(found.x)


class Daqp(Solver):
    """Dual active set, from the rows active in the program before."""

    name, form = "DAQP, condensed", Condensed

    def __init__(self, first: Any, form: Any) -> None:
        lib = importlib.import_module("daqp")
        self._solver = lib.Model()
        H, f, A, high, low = self.ready(first)
        self._solver.setup(H, f, A, high, low, np.zeros(len(high), dtype=np.int32))
        self._solver.settings = {"primal_tol": TOLERANCE, "dual_tol": TOLERANCE}

    def ready(self, program: Matrices) -> Any:
        """See `Solver`."""
        m = program
        high, low = np.r_[m.bounds[:, 1], m.high], np.r_[m.bounds[:, 0], m.low]
        P, A = np.ascontiguousarray(m.P), np.ascontiguousarray(m.G)
        if not len(A):  # it wants one row
            A, high, low = np.ones((1, len(m.q))), np.r_[high, NO_LIMIT], np.r_[low, -NO_LIMIT]
        return P, m.q, A, np.minimum(high, NO_LIMIT), np.maximum(low, -NO_LIMIT)

    def solve(self, ready: Any) -> np.ndarray:
        """See `Solver`."""
        H, f, A, high, low = ready
        self._solver.update(H=H, f=f, A=A, bupper=high, blower=low)
        x, _, flag, _ = self._solver.solve()
        solved(flag == 1, flag)
        return x


class Proxqp(Solver):
    """Proximal augmented Lagrangian, dense, warm started from the program before."""

    name, form = "ProxQP, condensed", Condensed

    def __init__(self, first: Any, form: Any) -> None:
        lib = importlib.import_module("proxsuite").proxqp
        H, g, C, low, high = self.ready(first)
        self._good = lib.PROXQP_SOLVED
        self._solver = lib.dense.QP(len(g), 0, len(low))
        settings = self._solver.settings
        settings.eps_abs, settings.eps_rel, settings.verbose = TOLERANCE, 0.0, False  # else its answers are others
        settings.initial_guess = lib.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        self._solver.init(H=H, g=g, C=C, l=low, u=high)

    def ready(self, program: Matrices) -> Any:
        """See `Solver`."""
        C, low, high = _dense_joined(program)
        return program.P, program.q, C, np.maximum(low, -NO_LIMIT), np.minimum(high, NO_LIMIT)

    def solve(self, ready: Any) -> np.ndarray:
        """See `Solver`."""
        H, g, C, low, high = ready
        self._solver.update(H=H, g=g, C=C, l=low, u=high, update_preconditioner=True)
        self._solver.solve()
        results = self._solver.results
        solved(results.info.status == self._good, results.info.status)
        return np.array(results.x)


def _dense_joined(program: Matrices) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = np.vstack([program.G, np.eye(len(program.q))])
    return rows, np.r_[program.low, program.bounds[:, 0]], np.r_[program.high, program.bounds[:, 1]]


def _full(dense: np.ndarray) -> Any:
    """Sparse, with every entry of it."""
    every = sp.csc_matrix(np.ones(dense.shape))
    return sp.csc_matrix((dense.T.ravel(), every.indices, every.indptr), dense.shape)
