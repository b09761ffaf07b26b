"""`RealTime`: settings of the fast solver."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Annotated, ClassVar, Literal
from weakref import WeakKeyDictionary

from slipangle.codegen.compiler import compiler, library, sentence
from slipangle.errors import ModelWarning, ParameterError
from slipangle.fields import Checked, Count, Whole, Within
from slipangle.optimal.engine import Engine
from slipangle.optimal.joined import Joined
from slipangle.optimal.joined_engine import JoinedEngine
from slipangle.optimal.ocp import OCP
from slipangle.optimal.realtime.curvature import require_curvature, unfit
from slipangle.optimal.realtime.engine import CompiledEngine
from slipangle.optimal.realtime.interpreted import Functions, InterpretedEngine
from slipangle.optimal.realtime.last_steps import LastSteps
from slipangle.optimal.realtime.program import source

# Scheduling before registers are given out: networks in the model gain a twentieth. Straight-line code is vectors
# already: looking for more of them took a sixth of the compiler's time and found nothing.
FLAGS = ("-fschedule-insns", "-fno-tree-slp-vectorize")

# Of problems in use: their C, by how quadratic programs are solved, and what runs without a compiler.
_WRITTEN: WeakKeyDictionary[OCP, dict[tuple[str, bool | None], str]] = WeakKeyDictionary()
_READY: WeakKeyDictionary[OCP, Functions] = WeakKeyDictionary()


@dataclass(frozen=True, kw_only=True)
class RealTime(Checked):
    """Real-time iteration ([1]_) in compiled code: Gauss-Newton steps on the condensed problem.

    The first plan is iterated to convergence from the inputs held or brought to zero, whichever promises less
    cost, and the states rolled out, so it needs no guess; later ones take `iterations` steps each from the plan
    before, shifted. After these the model is evaluated at the new plan; where `Plan.residual` is larger than `accept`,
    as after a jump of the state, or where hard limits allow no step, as after one of an obstacle, up to thirty steps
    with a line search follow, while there is time and until five in a row that keep no hard limit, or eight others,
    bring constraints no nearer. A solve that runs out of time or iterations is gone on with by the next one; every
    fifth in a row begins from nothing, as what was in the way may be gone.

    The quadratic program of a step is solved in one of two ways, which end at the same answer. "condensed" eliminates
    the states and goes from active set to active set ([2]_): fastest on short horizons. "riccati" keeps them and takes
    time proportional to the horizon: block pivoting ([3]_) from the rows active in the plan before, an interior point
    where these lead nowhere; what it cannot solve is condensed. "auto" compares the
    times of both, from the horizon, the sizes and the number of rows that were active in the plan before. Without a
    compiler programs are condensed.

    Parameters
    ----------
    iterations : int
        Gauss-Newton steps per plan; 0 iterates to convergence every time, and is not content with less.
    tolerance : float
        Of converged solutions: largest change of an input in the last step, relative to half its range [-]; where
        rounding makes the cost the same, steps are taken until they no longer shrink. Where it keeps a step that
        follows one of at most 1e-8 from doing any good, the plan is solved too; `Plan.residual` is then that step.
    max_iterations : int
        Most steps to convergence, of all starts together, a quarter of which "auto" saves for the last ones: where hard
        limits are missed, it begins anew elsewhere; in a row of fallbacks that missed them, at one of these starts by
        turns, and at all of them every fifth time.
    newton : float
        Accuracy of the implicit integrator's stages, relative to 1 + |state|. [-]
    accept : float
        Largest residual of real-time iterations that are a plan; see `Plan.residual`. [-]
    qp : {"auto", "condensed", "riccati"}
        How quadratic programs are solved; "auto" takes what is faster at each of them, and does not condense where
        states grow so much over the horizon, as those of a plant that is not stable, that little would be left of the
        weights of inputs. What its rounding leaves no optimum of is not `SOLVED`.
    hessian : {"auto", "gauss-newton", "exact"}
        Curvature of a step: squares of errors alone ("gauss-newton"), or with the second derivatives of dynamics,
        limits and errors by the multipliers of the step before ("exact"): all of them where they are positive on what
        the held limits leave free, else positive semidefinite node by node, without negative eigenvalues of what they
        add. Unless condensed, it tells a maximum from an optimum, and leaves it, or does not name it `SOLVED`. "exact"
        is for costs that are no squares, goes with ``iterations=0``, explicit integrators and a compiler. "auto" takes
        Gauss-Newton steps; plans with ``iterations=0`` that these do not end, as they contract so slowly that more are
        to come than there were, or lead to no plan, go on by the exact Hessian, with or without a compiler. That is
        compiled when a plan first needs it, or at once where there is a deadline.

    References
    ----------
    .. [1] M. Diehl, H. G. Bock, J. P. Schloeder, SIAM J. Control Optim. 43, 1714-1736, 2005.
    .. [2] D. Goldfarb, A. Idnani, Math. Program. 27, 1-33, 1983.
    .. [3] J. J. Judice, F. M. Pires, Comput. Oper. Res. 21, 587-596, 1994.
    """

    composes: ClassVar[bool] = True

    iterations: Whole = 1
    tolerance: Annotated[float, Within(0, open="low", example="1e-9")] = 1e-9
    max_iterations: Count = 400
    newton: Annotated[float, Within(0, open="low", example="1e-7")] = 1e-7
    accept: Annotated[float, Within(0, open="low", example="1e-2")] = 1e-2
    qp: Literal["auto", "condensed", "riccati"] = "auto"
    hessian: Literal["auto", "gauss-newton", "exact"] = "auto"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hessian == "exact" and self.iterations > 0:
            raise ParameterError(
                "the exact Hessian needs the multipliers of a step before, which real-time iterations do not have; "
                "expected plans to convergence: say RealTime(hessian='exact', iterations=0)"
            )

    def build(self, ocp: OCP, deadline: float | None = None) -> Engine:
        """Compile the problem, or take it from the cache.

        Raises
        ------
        ParameterError
            If the Hessian is to be exact and the problem has none.

        Warns
        -----
        ModelWarning
            Once, without a C compiler: the same algorithm then runs on CasADi's virtual machine, slower.
        """
        exact = self.hessian == "exact"
        if exact and not (isinstance(ocp, Joined) and ocp.curved is not None):
            require_curvature(ocp)
        if (ocp.composed or exact) and not isinstance(ocp, Joined):
            joined = Joined(ocp, curved=exact)
            return JoinedEngine(joined, self.build(joined, deadline))
        loaded = library(_source_of(ocp, self.qp), name="mpc", flags=FLAGS) if compiler() else None
        if loaded is not None:
            return CompiledEngine(ocp, loaded, self, deadline, self._last_steps(ocp, deadline))
        if exact:
            raise ParameterError(
                "the compiler failed, and the exact Hessian has compiled code alone; expected one that works, or "
                "Gauss-Newton: RealTime()"
            )
        if not compiler():  # a compiler that failed has been named already
            _say_once(sentence())
        return InterpretedEngine(ocp, self, deadline, _functions_of(ocp))

    def _last_steps(self, ocp: OCP, deadline: float | None) -> LastSteps | None:
        """What ends plans to convergence that these steps do not; none in a loop are to wait for a compiler."""
        if self.iterations > 0 or self.hessian != "auto" or unfit(ocp):
            return None
        base = ocp.base if isinstance(ocp, Joined) else ocp
        last = LastSteps(partial(_exact_engine, replace(self, hessian="exact"), base, deadline))
        return None if deadline is not None and last.engine is None else last


def _exact_engine(settings: RealTime, base: OCP, deadline: float | None) -> Engine | None:
    """The solver of a problem with its exact Hessian; None where it has none."""
    try:
        return settings.build(Joined(base, curved=True), deadline)
    except ParameterError:
        return None


def _source_of(ocp: OCP, qp: Literal["auto", "condensed", "riccati"]) -> str:
    """The problem's C, written once: another deadline or tolerance changes nothing of it, nor joining it anew."""
    base, curved = (ocp.base, ocp.curved is not None) if isinstance(ocp, Joined) else (ocp, None)
    written, way = _WRITTEN.setdefault(base, {}), (qp, curved)
    if way not in written:
        written[way] = source(ocp, qp=qp)
    return written[way]


def _functions_of(ocp: OCP) -> Functions:
    """The problem's functions for CasADi's virtual machine, made once."""
    made = _READY.get(ocp)
    if made is None:
        made = _READY[ocp] = Functions.of(ocp)
    return made


@cache
def _say_once(words: str) -> None:
    warnings.warn(words, ModelWarning, stacklevel=4)
