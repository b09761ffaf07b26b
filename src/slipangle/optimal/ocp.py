"""`OCP`: model, cost and limits of an optimal control problem, the one description all solvers share.

Solvers read its arrays and its two functions, `dynamics` and `stage`; none of them sees names.
"""

# Long: one problem; names become the arrays that all solvers read, in one place.
from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Literal, TypedDict
from uuid import uuid4

import casadi as ca
import numpy as np

from slipangle.errors import ModelWarning, ParameterError
from slipangle.fields import Checked, Count, Within
from slipangle.models.model import Model, without_caches
from slipangle.models.ode import OdeModel
from slipangle.ops import Scalar, Vector, atan2, cos, maximum, sin, stack
from slipangle.optimal.arrays import array, short
from slipangle.optimal.end import TerminalCost, lqr
from slipangle.optimal.idle import require_effect
from slipangle.optimal.scenarios import Scenarios
from slipangle.optimal.terms import Limits, Read, Weights, coerce, evaluated, require_names, require_same
from slipangle.paths.preview import Preview
from slipangle.shown import Brief

MOST_STEPS = 400  # of an explicit integrator in one sample: a compiler takes up to half a minute for so many
NOTHING = "nothing"  # of a problem that tracks none: solvers have an error all the same, which is zero
PATH_ERRORS = ("e_x", "e_y", "e_psi", "e_course")
AT_END = " at the end"  # of a limit there that is hard, though its quantity's limits are soft
MOVING = 0.1  # m/s, below which no direction of motion is told
POSE = ("X", "Y", "psi")


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference(Brief):
    """What the vehicle should do over the horizon.

    Parameters
    ----------
    tracked : array, shape (horizon + 1, n_references)
        Wanted values of ``ocp.references``, in that order, at the instants ``ocp.times``. SI units.
    exogenous : array, shape (horizon + 1, n_exogenous) or (horizon, n_exogenous)
        Inputs that are not decided, in the order of ``ocp.exogenous``, held over each stage; the last row, which is the
        one before where it is left out, is for what is tracked or limited at the end. SI units.
    inputs : array, shape (horizon, n_controls), optional
        Wanted inputs, from which R counts; zero by default.
    corridor : array, shape (horizon + 1, 2), optional
        Distance from the path to the lane's right and left edge [m], for an `OCP` with a corridor.
    limits : array, shape (horizon + 1, n_limited, 2), optional
        Limits of ``ocp.limited`` at each node in place of the problem's own; see `slipangle.optimal.setpoints.vary`.
    Q, R, S : array, shape (horizon + 1, n_tracked) and twice (horizon, n_controls), optional
        Weights of ``ocp.tracked`` and of ``ocp.controls`` in place of the problem's own, for stages of one step.
    scenarios : array, shape (n_scenarios, horizon + 1, n_values), optional
        Values of what the problem's ``scenarios`` name, in place of those there.
    """

    tracked: np.ndarray
    exogenous: np.ndarray
    inputs: np.ndarray | None = None
    corridor: np.ndarray | None = None
    limits: np.ndarray | None = None
    Q: np.ndarray | None = None
    R: np.ndarray | None = None
    S: np.ndarray | None = None
    scenarios: np.ndarray | None = None

    @property
    def varied(self) -> bool:
        """Whether it has limits or weights of its own."""
        return not (self.limits is None and self.Q is None and self.R is None and self.S is None)

    def require_plain(self, who: str) -> None:
        """Raise unless the problem's own limits, weights and scenarios are wanted, which ``who`` keeps to.

        Raises
        ------
        ParameterError
            With those that the reference has of its own.
        """
        own = [n for n in ("limits", "Q", "R", "S", "scenarios") if getattr(self, n) is not None]
        if own:
            raise ParameterError(
                f"the reference has {', '.join(own)} of its own; expected none: {who} keeps to those it was made with"
            )


def require_reference(reference: Any) -> None:
    """Raise unless this is a `Reference`.

    Raises
    ------
    ParameterError
        With what it is.
    """
    if not isinstance(reference, Reference):
        raise ParameterError(
            f"the reference is {short(reference)}; expected a Reference, or a Preview: use path.ahead(s, mpc.times)"
        )


class ProblemSettings(TypedDict, total=False):
    """What an `OCP` is built from besides its model."""

    horizon: int
    Q: Weights | Mapping[str, float]
    R: Weights | Mapping[str, float]
    S: Weights | Mapping[str, float]
    terminal: Weights | Mapping[str, float] | TerminalCost | Literal["lqr"] | None
    controls: str | Sequence[str]
    terminal_limits: Limits | Mapping[str, Any]
    parameters: str | Sequence[str]
    limits: Limits | Mapping[str, Any]
    rates: Limits | Mapping[str, Any]
    slack: Weights | Mapping[str, float]
    slack_linear: Weights | Mapping[str, float]
    corridor: float | None
    steps: Sequence[int] | None
    terms: Mapping[str, Callable[[Vector, Vector, Any], Scalar]]
    scenarios: Scenarios | None
    free: Limits | Mapping[str, Any]
    duration: tuple[float, float] | None
    huber: Weights | Mapping[str, float]


@dataclass(frozen=True, eq=False)
class OCP(Checked):
    """Track a reference over a horizon. [1]_ eqs. 5-3 to 5-8.

    ``J = sum_{i=0}^{N-1} (|y_i - q_i|^2_Q + |u_i - r_i|^2_R + |u_i - u_{i-1}|^2_S + slack) + |y_N - q_N|^2_terminal``
    subject to the model, where ``u_{-1}`` is the input applied before and x_0 the state now. Weights are
    diagonal, by name. A tracked name is a state or an output of the model or, for a model with X, Y and psi,
    an error relative to the reference pose: ``e_x`` along, ``e_y`` to the left of, ``e_psi`` in heading, and, where the
    model knows v_x and v_y, ``e_course`` in the direction of motion: heading plus side slip, [rad].

    Weights and limits may be dictionaries too, for names such as ``r[k-1]`` that are no Python identifiers.

    Stages may be several steps of the model long, ``steps[i]`` of them with the input held, so that few inputs look
    far ahead. The sums are then integrals over time in steps of the model: Q, R and slack of stage i count
    ``steps[i]`` times (an excess where the stage ends), the squared change to stage i one over the steps between the
    middles of the two stages, and the end once.

    Parameters
    ----------
    model : Model
        Predicts; its sample time is the step of the problem.
    horizon : int
        Stages N.
    steps : sequence of int, optional
        Length of each stage in steps of the model, by default all 1; the first must be 1, because a controller plans
        anew at every step of the model.
    Q : Weights
        On tracked states, outputs and path errors.
    R, S : Weights
        On inputs, and on their change from step to step.
    terminal : Weights or TerminalCost or "lqr", optional
        On tracked quantities at the end; Q by default. A `TerminalCost` is a full matrix, and "lqr" that of the
        regulator that goes on from there, at zero; `lqr` makes it for other steady states.
    controls : tuple of str
        Inputs that are decided; by default those named in R, S, limits or rates. The others are exogenous:
        the reference brings their values.
    limits : Limits
        On decided inputs, always kept; on states, outputs and path errors, at the end of every stage
        (an output that depends on an input also now).
    rates : Limits
        On the change of decided inputs, per second: from stage to stage over the time between their middles, also where
        the duration is decided; the first change then counts over a step of the model.
    terminal_limits : Limits
        On states, outputs, path errors and terms at the end alone, besides ``limits``; two equal numbers make it an
        equation. They are hard, also where a slack softens the ``limits`` of the same name; a name with a slack that
        stands here alone is soft.
    parameters : tuple of str
        What terms read besides the model's quantities, as ``p.name``, with a value at every node that comes with the
        reference, as those of exogenous inputs do.
    slack, slack_linear : Weights
        Names in them have soft limits: weight of the squared, of the plain excess. A plain weight that is
        large enough keeps the limit exactly whenever that is possible. Limits of other names are hard.
    terms : mapping of str to callable, optional
        Further quantities, each a function ``(x, u, p)`` of the model's state, its inputs and its ``params`` (None
        where it has none) with the problem's ``parameters``, written with `slipangle.ops`. Their names may stand in Q
        and terminal, which bring them to zero, and in limits, slack and slack_linear; SI units.
    corridor : float, optional
        Vehicle width to keep between the edges of the lane [m]: limits ``e_y`` by the reference's corridor.
    scenarios : Scenarios, optional
        Several values of what is not known; the plan has a branch for each, with the first inputs in common.
    free : Limits
        What is decided once for the whole horizon, and within which limits: parameters of a model made of equations, or
        names from ``parameters``. They may stand in Q, terminal and terms. The first guess is the model's own value, or
        that of a parameter of terms that comes with the reference; or ``MPC.guess(decided=...)`` says it.
    duration : (float, float), optional
        Shortest and longest time that the horizon may take [s], which is then decided too: all stages grow alike. It is
        tracked, and read by terms, under the name ``duration``; of models made of equations.
    huber : Weights
        Bends of Huber costs by tracked name, in its unit: an error ``e`` beyond its bend ``d`` costs
        ``d (2 |e| - d)`` instead of ``e^2``, times its weight in Q or terminal; a `TerminalCost` is not bent. [2]_

    Attributes
    ----------
    identity : str
        Name of this problem, which its copies share and no other ever has.

    Raises
    ------
    ParameterError
        If a name is not known (with the nearest ones), the horizon is below 1, steps do not fit it, nothing is tracked
        or decided, a term is no function of numbers, nothing reads a parameter, or the model takes thousands of steps a
        sample.

    References
    ----------
    .. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023. There the sums run over i = 0..N-1 and S from i = 1; here the
       last state and the first change count too.
    .. [2] P. J. Huber, Ann. Math. Statist. 35, 73-101, 1964.
    """

    model: Model
    _: KW_ONLY
    horizon: Count
    Q: Weights
    R: Weights = field(default_factory=Weights)
    S: Weights = field(default_factory=Weights)
    terminal: Weights | TerminalCost | None = None
    controls: tuple[str, ...] = ()
    limits: Limits = field(default_factory=Limits)
    rates: Limits = field(default_factory=Limits)
    slack: Weights = field(default_factory=Weights)
    slack_linear: Weights = field(default_factory=Weights)
    corridor: Annotated[float, Within(0, unit="m", open="low")] | None = None
    steps: Sequence[int] | None = None
    terms: Mapping[str, Callable[[Vector, Vector, Any], Scalar]] = field(default_factory=dict)
    terminal_limits: Limits = field(default_factory=Limits)
    parameters: tuple[str, ...] = ()
    scenarios: Scenarios | None = None
    free: Limits = field(default_factory=Limits)
    duration: tuple[float, float] | None = None
    huber: Weights = field(default_factory=Weights)
    identity: str = field(init=False, repr=False, default_factory=lambda: uuid4().hex)

    def __post_init__(self) -> None:
        regulated = isinstance(self.terminal, str) and self.terminal == "lqr"
        if regulated:
            object.__setattr__(self, "terminal", None)
        full = self.terminal is None or isinstance(self.terminal, TerminalCost)
        coerce(self, Weights, "Q", "R", "S", "slack", "slack_linear", "huber", *(() if full else ("terminal",)))
        coerce(self, Limits, "limits", "rates", "terminal_limits", "free")
        model = self.model
        super().__post_init__()
        many = getattr(model, "substeps", 1)
        if getattr(model, "method", "radau") != "radau" and many > MOST_STEPS:
            raise ParameterError(
                f"a sample of the model takes {many} explicit steps, each of them code in a controller; expected at "
                f"most {MOST_STEPS}: give the model substeps=..., about four to its shortest time constant, or "
                "method='radau'"
            )
        if self.steps is not None:
            object.__setattr__(self, "steps", _checked_steps(self.steps, self.horizon, model.dt))
        named = (*self.R, *self.S, *self.limits, *self.rates)
        chosen = (self.controls,) if isinstance(self.controls, str) else tuple(self.controls)
        require_names(chosen, model.inputs, "controls", "use inputs of the model")
        if len(set(chosen)) < len(chosen):
            raise ParameterError(f"controls repeat in {list(chosen)}; expected each input once")
        taken = sorted({*self.terms} & {*model.states, *model.inputs, *model.outputs, *PATH_ERRORS})
        if taken:
            raise ParameterError(f"terms name {taken}, which the model has; expected names of their own: rename them")
        object.__setattr__(self, "parameters", _checked_parameters(self))
        require_parts(self)
        controls = tuple(chosen) or tuple(n for n in model.inputs if n in named)
        object.__setattr__(self, "controls", controls)
        if not controls:
            raise ParameterError(
                f"no input is decided; expected some of {list(model.inputs)}: name one in controls, R, S, "
                "limits or rates"
            )
        trackable = self._trackable
        self._require_ends(trackable)
        for what, names in (("R", self.R), ("S", self.S), ("rates", self.rates)):
            require_names(names, controls, what, "use a decided input")
        require_names(self.limits, (*controls, *trackable), "limits", "use a decided input, a state or an output")
        for what, weights in (("slack", self.slack), ("slack_linear", self.slack_linear)):
            require_names(weights, self.limited, what, "use a state or output that has a limit")
        for name, (lower, upper) in self.rates.items():
            if not lower <= 0 <= upper:
                raise ParameterError(f"the rate limit of '{name}' is ({lower}, {upper}); expected one that contains 0")
        if self.terms:
            self._require_terms()
        require_effect(self)
        if self.corridor is not None:
            require_names(("e_y",), trackable, "corridor", "use a model with X, Y and psi, such as OnGround(model)")
        if regulated:
            object.__setattr__(self, "terminal", lqr(self))
            for name in ("tracked", "references", "limited", "stage", "weights"):  # of the problem without it
                self.__dict__.pop(name, None)

    def _require_ends(self, trackable: list[str]) -> None:
        """Raise unless something is tracked, and names and limits of the end make sense.

        Raises
        ------
        ParameterError
            With the name.
        """
        require_names(self.Q, trackable, "Q")
        if isinstance(self.terminal, TerminalCost):
            require_names(self.terminal.names, (*trackable, *self.controls), "terminal")
        else:
            require_names(self.terminal or {}, trackable, "terminal")
        require_names(self.huber, self._bendable, "huber", "use a name with a weight in Q or terminal")
        flat = [name for name, bend in self.huber.items() if not bend > 0]
        if flat:
            raise ParameterError(f"the bend of '{flat[0]}' in huber is 0; expected a positive one, in its unit")
        require_names(self.terminal_limits, trackable, "terminal_limits", "use a state or an output")
        if self.tracked == (NOTHING,) and not (self.limited and (self.R or self.S or self.slack or self.slack_linear)):
            raise ParameterError(
                f"nothing is tracked; expected weights on some of {trackable}: set Q, or limits of them that R, S or a "
                "slack is to keep at least cost"
            )
        said = [name for name in ("reference", "previous", "applied") if name in self.references]
        if said:
            raise ParameterError(
                f"'{said[0]}' is tracked, which is a word of plan(); expected another name: rename it in the model"
            )
        if self.corridor is not None and "e_y" in self.terminal_limits:
            raise ParameterError(
                "terminal_limits name 'e_y', which the corridor limits; expected one of both: narrow the last row "
                "of the corridor"
            )
        for name, (lower, upper) in zip(self.limited, self.limits_at_nodes[-1], strict=True):
            if lower > upper:
                raise ParameterError(
                    f"at the end '{name}' has a lower limit of {lower:g} and an upper one of {upper:g}; expected some "
                    "room in both limits and terminal_limits"
                )

    def __getstate__(self) -> dict[str, Any]:
        """What a copy needs, in this process or another: its settings, nothing compiled."""
        return without_caches(self)

    # ---- time --------------------------------------------------------------------------------------------------

    @property
    def dt(self) -> float:
        """Step of the model and time between plans. [s]"""
        return self.model.dt

    @cached_property
    def lengths(self) -> np.ndarray:
        """Length of each stage in steps of the model, shape (horizon,)."""
        return np.ones(self.horizon, dtype=int) if self.steps is None else np.array(self.steps, dtype=int)

    @cached_property
    def nodes(self) -> np.ndarray:
        """How many steps of the model lead to each stage and to the end, shape (horizon + 1,)."""
        return np.concatenate([[0], np.cumsum(self.lengths)])

    @cached_property
    def stage_of(self) -> np.ndarray:
        """Stage of each step of the model, shape (n_steps,)."""
        return np.repeat(np.arange(self.horizon), self.lengths)

    @cached_property
    def times(self) -> np.ndarray:
        """Instants of the states and references, now and at the end of each stage, shape (horizon + 1,). [s]"""
        return self.dt * self.nodes

    # ---- names -------------------------------------------------------------------------------------------------

    @property
    def _trackable(self) -> list[str]:
        known = (*self.model.states, *self.model.outputs, *self._path_errors)
        return list(dict.fromkeys((*known, *self.terms, *self.decided_once)))

    @cached_property
    def _path_errors(self) -> tuple[str, ...]:
        """Those that a pose has; in a model without one these are names as others are."""
        if not set(POSE) <= {*self.model.states, *self.model.outputs}:
            return ()
        return PATH_ERRORS if self._coursed else PATH_ERRORS[:-1]

    @property
    def _coursed(self) -> bool:
        """Whether the model says where the vehicle moves to, by v_x and v_y."""
        return {"v_x", "v_y"} <= {*self.model.states, *self.model.outputs, *self.model.inputs}

    @property
    def decided_once(self) -> tuple[str, ...]:
        """What is decided once for the whole horizon: `free`, and ``duration`` where that is."""
        return (*self.free, *(() if self.duration is None else ("duration",)))

    @property
    def composed(self) -> bool:
        """Whether solvers are given another problem, with scenarios, free parameters, Huber costs; see `joined`."""
        return self.scenarios is not None or bool(self.decided_once) or bool(self.huber)

    @property
    def _bendable(self) -> tuple[str, ...]:
        """Tracked names whose cost may be bent."""
        return tuple(self.Q) if isinstance(self.terminal, TerminalCost) else self.tracked

    @cached_property
    def presumed(self) -> dict[str, float]:
        """Values of exogenous columns that need not be said: means of scenarios, middles of what is free. SI units."""
        known = {} if self.scenarios is None else self.scenarios.means
        return {**known, **{n: middle(low, high) for n, (low, high) in self.free.items()}}

    @cached_property
    def exogenous(self) -> tuple[str, ...]:
        """Inputs that are not decided, in the model's order, and parameters."""
        return (*(n for n in self.model.inputs if n not in self.controls), *self.parameters)

    @cached_property
    def tracked(self) -> tuple[str, ...]:
        """Quantities with a weight in Q or at the end, the rows of the error in `stage`."""
        if isinstance(self.terminal, TerminalCost):
            return (*self.Q, *(f"terminal[{k}]" for k in range(len(self.terminal.rows))))
        return tuple(dict.fromkeys((*self.Q, *(self.terminal or ())))) or (NOTHING,)

    @cached_property
    def limited(self) -> tuple[str, ...]:
        """States, outputs and path errors with a limit, the rows of the second result of `stage`."""
        names = [*(n for n in self.limits if n not in self.controls), *map(self._named_at_end, self.terminal_limits)]
        return tuple(dict.fromkeys((*names, *(("e_y",) if self.corridor is not None else ()))))

    def _named_at_end(self, name: str) -> str:
        """A terminal limit's row in `limited`: its own where limits along the horizon are soft, which it is not."""
        softened = name in self.limits and (name in self.slack or name in self.slack_linear)
        return f"{name}{AT_END}" if softened else name

    @cached_property
    def references(self) -> tuple[str, ...]:
        """Quantities whose wanted values the reference brings; path errors need the pose."""
        used = self.tracked
        if isinstance(self.terminal, TerminalCost):
            used = (*self.Q, *(n for n in self.terminal.names if n not in self.controls))
        errors = self._path_errors
        plain = [n for n in used if n not in errors and n not in self.terms and n != NOTHING]
        pose = POSE if {*errors} & {*used, *self.limited} else ()
        return tuple(dict.fromkeys((*plain, *pose)))

    @cached_property
    def headings(self) -> tuple[int, int] | None:
        """Where states and references have the heading of a pose, which counts by the nearest turn; None without."""
        if "psi" not in self.references or not set(POSE) <= {*self.model.states}:
            return None
        return self.model.states.index("psi"), self.references.index("psi")

    @cached_property
    def soft(self) -> tuple[str, ...]:
        """Limited quantities whose limits may be exceeded at a price."""
        return tuple(n for n in self.limited if n in self.slack or n in self.slack_linear)

    # ---- functions ---------------------------------------------------------------------------------------------

    @cached_property
    def dynamics(self) -> ca.Function:
        """``(x, u, w) -> x`` one step of the model later; u decided, w exogenous inputs."""
        x, u, w, full, _ = self.symbols(self._kind)
        return ca.Function("dynamics", [x, u, w], [self.model.functions[0](x, full)], ["x", "u", "w"], ["next"])

    @cached_property
    def stage(self) -> ca.Function:
        """``(x, u, w, p) -> errors of `tracked`, values of `limited```; p the wanted values of `references`."""
        x, u, w, full, p = self.symbols(self._kind)
        y = self.model.functions[1](x, full)
        values: dict[str, Scalar] = {name: y[i] for i, name in enumerate(self.model.outputs)}
        values.update({name: x[i] for i, name in enumerate(self.model.states)})
        wanted: dict[str, Scalar] = {name: p[i] for i, name in enumerate(self.references)}
        if self._path_errors and set(POSE) <= wanted.keys():
            dx, dy, psi = values["X"] - wanted["X"], values["Y"] - wanted["Y"], wanted["psi"]
            values["e_x"] = cos(psi) * dx + sin(psi) * dy
            values["e_y"] = cos(psi) * dy - sin(psi) * dx
            values["e_psi"] = values["psi"] - psi
            if self._coursed:
                known = {**{n: full[i] for i, n in enumerate(self.model.inputs)}, **values}
                values["e_course"] = values["e_psi"] + atan2(known["v_y"], maximum(known["v_x"], MOVING))
        values.update(self._more(x, u, w))
        params = self._read(x, w)
        values.update({name: evaluated(name, term, x, full, params) for name, term in self.terms.items()})

        def missed(name: str) -> Scalar:
            if name == NOTHING:
                return 0 * x[0]
            return values[name] - (0.0 if name in self._path_errors or name in self.terms else wanted[name])

        if isinstance(self.terminal, TerminalCost):
            each = [u[self.controls.index(n)] if n in self.controls else missed(n) for n in self.terminal.names]
            rows = [sum((float(f) * e for f, e in zip(row, each, strict=True) if f), 0.0) for row in self.terminal.rows]
        else:
            rows = []
        error = [*(missed(n) - self._excess(n, u, w) for n in self._bendable), *rows, *self._curved(x, u, w)]
        limited = [values[n.removesuffix(AT_END)] for n in self.limited]
        empty = type(x)(0, 1)
        results = [stack(error), stack(limited) if limited else empty]
        return ca.Function("stage", [x, u, w, p], results, ["x", "u", "w", "p"], ["error", "limited"])

    def _read(self, x: Any, w: Any) -> Any:
        """What terms read as ``p``."""
        params, beside = getattr(self.model, "params", None), self._beside(x, w)
        return Read(params, beside) if beside else params

    def _require_terms(self) -> None:
        """Raise unless every term gives one number, the same on symbols as on numbers; warn of one with nothing to do.

        Raises
        ------
        ParameterError
            With the term.
        """
        sizes = self.model.n_states, self.model.n_inputs, len(self.exogenous)
        x, u, w = (self._kind.sym(k, n) for k, n in zip("xuw", sizes, strict=True))
        for name, term in self.terms.items():
            value = evaluated(name, term, x, u, self._read(x, w))
            require_same(name, term, value, (x, u, w), self._read)
        end = self.terminal.names if isinstance(self.terminal, TerminalCost) else self.terminal or ()
        idle = [name for name in self.terms if name not in {*self.Q, *end, *self.limits, *self.terminal_limits}]
        if idle:
            warnings.warn(
                f"the term '{idle[0]}' is neither limited nor has a weight; expected it in Q, terminal, limits or "
                "terminal_limits: it does nothing",
                ModelWarning,
                stacklevel=4,
            )

    def _beside(self, x: Any, w: Any) -> dict[str, Any]:
        """What terms read besides the model's parameters, by name."""
        first = len(self.exogenous) - len(self.parameters)
        known = {name: w[first + i] for i, name in enumerate(self.parameters)}
        if self.duration is not None:
            known["duration"] = 0 * x[0] + middle(*self.duration)
        return known

    def _more(self, x: Any, u: Any, w: Any) -> dict[str, Any]:
        """Quantities that are neither states nor outputs, by name; of what is decided once, a guess."""
        bounds = {**self.free, **({} if self.duration is None else {"duration": self.duration})}
        return {name: 0 * x[0] + middle(low, high) for name, (low, high) in bounds.items()}

    def _excess(self, name: str, u: Any, w: Any) -> Any:
        """How far the error of a name is beyond its bend; see `joined`."""
        return 0.0

    def _curved(self, x: Any, u: Any, w: Any) -> list[Any]:
        """Errors that are zero, whose derivatives are a solver's; see `joined`."""
        return []

    @property
    def _kind(self) -> Any:
        """Scalar expressions where the model allows, else matrices."""
        return ca.SX if all(f.is_a("SXFunction") for f in self.model.functions[:2]) else ca.MX

    def symbols(self, kind: Any) -> tuple[Any, Any, Any, Any, Any]:
        """x, u, w, the model's input vector and p, as CasADi's ``SX`` or ``MX``."""
        sizes = self.model.n_states, len(self.controls), len(self.exogenous), len(self.references)
        x, u, w, p = (kind.sym(name, n) for name, n in zip("xuwp", sizes, strict=True))
        return x, u, w, self.all_inputs(u, w), p

    def all_inputs(self, u: Any, w: Any) -> Any:
        """The model's input vector from decided inputs ``u`` and exogenous ones ``w``, as symbols."""
        parts = [
            u[self.controls.index(n)] if n in self.controls else w[self.exogenous.index(n)] for n in self.model.inputs
        ]
        return ca.vertcat(*parts)

    @cached_property
    def rated(self) -> np.ndarray:
        """Controls whose change is limited at some stage, by their places, shape (n_rated,)."""
        return np.flatnonzero(np.isfinite(self.step_bounds).any(axis=(0, 2)))

    @cached_property
    def jumps(self) -> tuple[int, ...]:
        """Stages that take no time: what follows them is `jump`, not the model; see `joined`."""
        return ()

    @cached_property
    def jump(self) -> ca.Function | None:
        """``(x, u, w) -> x`` after such a stage."""
        return None

    @cached_property
    def ends(self) -> np.ndarray:
        """Nodes behind which a jump, or nothing, follows, shape (n_ends,)."""
        return np.array([self.horizon])

    @cached_property
    def later_x(self) -> np.ndarray:
        """Node at which the plan of a step before has what each node has now, shape (horizon + 1,)."""
        return np.minimum(np.arange(1, self.horizon + 2), self.horizon)

    @cached_property
    def later_u(self) -> np.ndarray:
        """The same of stages, shape (horizon,)."""
        return np.minimum(np.arange(1, self.horizon + 1), self.horizon - 1)

    @cached_property
    def limited_now(self) -> np.ndarray:
        """Which limited quantities depend on the input at the same step, shape (n_limited,).

        Those are limited now too, the others from the next step on.
        """
        x, u, w, p = (ca.MX.sym(self.stage.name_in(i), self.stage.size1_in(i)) for i in range(4))
        jacobian = ca.Function("j", [x, u, w, p], [ca.jacobian(self.stage(x, u, w, p)[1], u)])
        pattern = np.asarray(ca.DM(jacobian.sparsity_out(0), 1.0).full()) != 0
        if not self.limited:
            return np.zeros(0, dtype=bool)
        return pattern.any(axis=1) & self.limited_along

    @cached_property
    def limited_at(self) -> np.ndarray:
        """At which nodes which quantities are limited, shape (horizon + 1, n_limited)."""
        at = np.tile(self.limited_along, (self.horizon + 1, 1))
        at[0], at[-1] = self.limited_now, True
        return at

    @cached_property
    def limited_along(self) -> np.ndarray:
        """Which limited quantities are limited before the end too, shape (n_limited,)."""
        along = {*self.limits, *(("e_y",) if self.corridor is not None else ())}
        return np.array([name in along for name in self.limited], dtype=bool)

    # ---- arrays ------------------------------------------------------------------------------------------------

    @cached_property
    def weights(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Q and terminal over `tracked`, R and S over `controls`; shapes (n_tracked,), (n_controls,)."""
        q = _row(self.Q, self.tracked)
        if isinstance(self.terminal, TerminalCost):
            end = (np.arange(len(self.tracked)) >= len(self.Q)).astype(float)
        else:
            end = q if self.terminal is None else _row(self.terminal, self.tracked)
        return q, end, _row(self.R, self.controls), _row(self.S, self.controls)

    @cached_property
    def input_bounds(self) -> np.ndarray:
        """Lower and upper bound of each control, shape (n_controls, 2); infinite where there is none."""
        return _rows(self.limits, self.controls)

    @cached_property
    def _apart(self) -> np.ndarray:
        """Steps from the middle of the stage before to that of each stage, shape (horizon,); the first 1."""
        return 0.5 * (np.concatenate([[1], self.lengths[:-1]]) + self.lengths)

    @cached_property
    def step_bounds(self) -> np.ndarray:
        """Lower and upper bound of the change of each control to each stage, shape (horizon, n_controls, 2)."""
        return self._apart[:, None, None] * (_rows(self.rates, self.controls) * self.dt)

    def step_bounds_over(self, duration: float | None) -> np.ndarray:
        """`step_bounds` where the whole horizon takes so long [s]; the first change counts over a step of the model."""
        bounds = self.step_bounds.copy()
        if duration is not None:
            bounds[1:] *= duration / (self.horizon * self.dt)
        return bounds

    @cached_property
    def stage_weights(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`weights` as they count at each stage.

        Of errors, shape (horizon + 1, n_tracked), of inputs and of their changes, shape (horizon, n_controls).
        """
        q, end, r, s = self.weights
        return np.vstack([np.outer(self.lengths, q), end]), np.outer(self.lengths, r), np.outer(1 / self._apart, s)

    def weights_for(self, reference: Reference) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`stage_weights`, or those that a reference has of its own.

        Of errors, shape (horizon + 1, n_tracked), of inputs and of their changes, shape (horizon, n_controls).
        """
        given = zip((reference.Q, reference.R, reference.S), self._counts, self.stage_weights, strict=True)
        q, r, s = (usual if own is None else counts * own for own, counts, usual in given)
        return q, r, s

    @cached_property
    def _counts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How many times errors, inputs and changes count at each stage, errors at the end too; a column each."""
        return np.append(self.lengths, 1)[:, None], self.lengths[:, None], 1 / self._apart[:, None]

    @cached_property
    def excess_counts(self) -> np.ndarray:
        """How many times an excess over a soft limit counts, now and at the end of each stage, shape (horizon + 1,)."""
        return np.concatenate([[1], self.lengths])

    @cached_property
    def slack_weights(self) -> tuple[np.ndarray, np.ndarray]:
        """Squared and plain weight of each of `soft`, shapes (n_soft,)."""
        return _row(self.slack, self.soft), _row(self.slack_linear, self.soft)

    def state_bounds(self, reference: Reference) -> np.ndarray:
        """Bounds of `limited` now and at the end of each stage, shape (horizon + 1, n_limited, 2)."""
        bounds = (self.limits_at_nodes if reference.limits is None else np.asarray(reference.limits)).copy()
        if self.corridor is not None and reference.corridor is not None:
            e_y, half = bounds[:, self.limited.index("e_y")], 0.5 * self.corridor
            right, left = np.asarray(reference.corridor, dtype=float).T
            lower, upper = half - right, left - half
            narrow = lower > upper  # than the vehicle: keep to the lane's middle
            if narrow.any():
                both = np.isfinite(right) & np.isfinite(left)
                middle = 0.5 * (np.where(both, left, 0.0) - np.where(both, right, 0.0))
                lower, upper = np.where(narrow, middle, lower), np.where(narrow, middle, upper)
            np.maximum(e_y[:, 0], lower, out=e_y[:, 0])
            np.minimum(e_y[:, 1], upper, out=e_y[:, 1])
        return bounds

    @cached_property
    def limits_at_nodes(self) -> np.ndarray:
        """Bounds of `limited` without a corridor at each node, shape (horizon + 1, n_limited, 2)."""
        bounds = np.tile(self.state_limits, (self.horizon + 1, 1, 1))
        at_end = Limits({self._named_at_end(n): both for n, both in self.terminal_limits.items()})
        end = _rows(at_end, self.limited)
        bounds[-1] = np.stack(
            [np.maximum(bounds[-1, :, 0], end[:, 0]), np.minimum(bounds[-1, :, 1], end[:, 1])], axis=1
        )
        return bounds

    @cached_property
    def state_limits(self) -> np.ndarray:
        """Bounds of `limited` without a corridor, shape (n_limited, 2)."""
        return _rows(self.limits, self.limited)

    # ---- references --------------------------------------------------------------------------------------------

    def reference(self, preview: Preview, **exogenous: np.ndarray | float) -> Reference:
        """`Reference` from a look along a path.

        Parameters
        ----------
        preview : Preview
            From ``path.ahead(s, ocp.times)``, horizon + 1 rows. X, Y, psi, v_x, r and curvature come from
            it; other tracked quantities, such as v_y, are wanted at zero.
        **exogenous : array, shape (horizon + 1,) or (horizon,), or float
            Exogenous inputs; ``v_x``, its rate of change ``v_x_dot`` and ``curvature`` come from the preview unless
            given.

        Raises
        ------
        ParameterError
            If an exogenous input is missing or unknown, or the preview is not at `times`.
        """
        rows = self.horizon + 1
        preview.require_times(self.times)
        require_names(exogenous, self.exogenous, "reference()", "use an input that is not decided")
        known = (*POSE, "v_x", "r", "curvature")
        seen = {"v_x": preview.v_x, "curvature": preview.curvature}
        given: dict[str, Any] = {**self.presumed, **seen, **exogenous}
        if "v_x_dot" in self.exogenous and "v_x_dot" not in given:
            given["v_x_dot"] = preview.v_x_dot(self.times)
        for name in self.exogenous:
            if name not in given:
                raise ParameterError(
                    f"the exogenous input '{name}' is not in the preview; expected its values: "
                    f"say mpc.reference(preview, {name}=...), or decide it by naming it in controls"
                )
        columns = [getattr(preview, n) if n in known else np.zeros(rows) for n in self.references]
        inputs = [at_nodes(np.asarray(given[n], dtype=float), self.horizon) for n in self.exogenous]
        return Reference(
            tracked=_side_by_side(columns, rows),
            exogenous=_side_by_side(inputs, rows),
            corridor=_side_by_side([preview.right, preview.left], rows),
        )

    @cached_property
    def _shapes(self) -> dict[str, tuple[tuple[int, ...], list[str]]]:
        """Shape and columns of each array of a reference."""
        n = self.horizon
        return {
            "tracked": ((n + 1, len(self.references)), list(self.references)),
            "exogenous": ((n + 1, len(self.exogenous)), list(self.exogenous)),
            "inputs": ((n, len(self.controls)), list(self.controls)),
            "corridor": ((n + 1, 2), ["right", "left"]),
            "limits": ((n + 1, len(self.limited), 2), ["lower", "upper"]),
            "Q": ((n + 1, len(self.tracked)), list(self.tracked)),
            "R": ((n, len(self.controls)), list(self.controls)),
            "S": ((n, len(self.controls)), list(self.controls)),
            "scenarios": self._shape_of_scenarios,
        }

    @property
    def _shape_of_scenarios(self) -> tuple[tuple[int, ...], list[str]]:
        s = self.scenarios
        return ((0, 0, 0), []) if s is None else ((len(s), self.horizon + 1, len(s.values)), list(s.values))

    def check_reference(self, reference: Reference) -> Reference:
        """The reference as arrays of numbers in the shapes of this problem; the same one where it has them.

        Raises
        ------
        ParameterError
            With the array, its shape and the one expected.
        """
        require_reference(reference)
        changed: dict[str, np.ndarray] = {}
        for key, (shape, names) in self._shapes.items():
            given = getattr(reference, key)
            if given is not None or key in ("tracked", "exogenous"):
                if key == "exogenous" and _height(given) == self.horizon:
                    shape = self.horizon, shape[1]
                checked = array(given, shape, names, f"reference.{key}")
                if checked is not given:
                    changed[key] = checked
                if key in ("limits", "Q", "R", "S"):
                    _require_sense(key, checked, self.limited if key == "limits" else names)
        self._require_bent(reference)
        if self.corridor is not None and reference.corridor is None:
            raise ParameterError(
                "the reference has no corridor; expected one for this problem: use mpc.reference(preview)"
            )
        if self.corridor is not None and reference.limits is not None:
            e_y = self.limited.index("e_y")
            if not np.array_equal(np.asarray(reference.limits)[:, e_y], self.limits_at_nodes[:, e_y]):
                raise ParameterError("reference.limits has limits of 'e_y' too; expected them in the corridor alone")
        return replace(reference, **changed) if changed else reference

    @property
    def bent_at_end(self) -> tuple[str, ...]:
        """Names with a Huber cost that count at the end too."""
        end = self.weights[1]
        return tuple(name for name in self.huber if end[self.tracked.index(name)] > 0)

    def _require_bent(self, reference: Reference) -> None:
        """Raise where a reference counts a Huber cost at the end, and the problem does not.

        Raises
        ------
        ParameterError
            With the name.
        """
        for name in self.huber if reference.Q is not None else ():
            if name not in self.bent_at_end and np.asarray(reference.Q)[-1, self.tracked.index(name)] > 0:
                raise ParameterError(
                    f"reference.Q counts '{name}' at the end, whose Huber cost ends before; expected 0 there, or a "
                    "problem with a weight of it in terminal"
                )


def _require_sense(key: str, given: np.ndarray, names: Sequence[str]) -> None:
    """Raise unless limits leave something between them and weights are not negative.

    Raises
    ------
    ParameterError
        With the name and the node of the first that do not.
    """
    between = key == "limits"
    good = given[..., 0] <= given[..., 1] if between else (given >= 0) & np.isfinite(given)
    if not good.all():
        node, j = np.argwhere(~good)[0]
        got = (
            f"limits of {given[node, j, 0]:g} and {given[node, j, 1]:g}"
            if between
            else f"a weight of {given[node, j]:g}"
        )
        wanted = "a lower one no higher than the upper one" if between else "a finite number from 0 on"
        raise ParameterError(f"reference.{key} has {got} for '{names[j]}' at node {node}; expected {wanted}")


def middle(low: float, high: float) -> float:
    """Between two limits, one of which may be infinite; 0 where both are."""
    if np.isfinite(low) and np.isfinite(high):
        return 0.5 * (low + high)
    return float(low if np.isfinite(low) else high if np.isfinite(high) else 0.0)


def require_parts(ocp: OCP) -> None:
    """Raise unless scenarios and free parameters name what there is.

    Raises
    ------
    ParameterError
        With the name.
    """
    model, given = ocp.model, ocp.scenarios
    if not isinstance(given, Scenarios | None):
        raise ParameterError(
            f"scenarios is {short(given)}; expected Scenarios: say Scenarios({{'friction': (0.6, 1)}})"
        )
    own = model.parameter_names if isinstance(model, OdeModel) and not model.own_step else ()
    varied = () if given is None else tuple(given.values)
    inputs = [n for n in model.inputs if n not in ocp.controls]
    require_names(varied, (*inputs, *ocp.parameters, *own), "scenarios", "use an exogenous input or a parameter")
    require_names(ocp.free, (*ocp.parameters, *own), "free", "use one of parameters, or of an ODE's parameters")
    twice = sorted({*varied} & {*ocp.free})
    if twice:
        raise ParameterError(f"{twice} are both free and in scenarios; expected one of both")
    if (given is not None or ocp.decided_once) and ocp.steps is not None:
        raise ParameterError(
            "steps are given with scenarios or free parameters; expected stages of one step: leave out steps"
        )
    if given is not None and given.common > ocp.horizon:
        raise ParameterError(f"common is {given.common}; expected at most the horizon, {ocp.horizon}")
    if ocp.duration is not None:
        try:
            low, high = (float(v) for v in ocp.duration)
        except (TypeError, ValueError):
            low, high = 0.0, 0.0
        if not (0 < low <= high < np.inf):
            raise ParameterError(
                f"the duration is {short(ocp.duration)}; expected (shortest, longest) in seconds, above 0"
            )
        if not isinstance(model, OdeModel) or model.own_step:
            raise ParameterError(
                "the duration is free, but the model is no ODE, whose steps could be stretched; expected an Ode"
            )
        object.__setattr__(ocp, "duration", (low, high))


def _checked_parameters(ocp: OCP) -> tuple[str, ...]:
    """Parameters as a tuple.

    Raises
    ------
    ParameterError
        If one is no text, is there twice, or is a quantity of the model or a term.
    """
    given = (ocp.parameters,) if isinstance(ocp.parameters, str) else tuple(ocp.parameters)
    model = ocp.model
    taken = {*model.states, *model.inputs, *model.outputs, *PATH_ERRORS, *ocp.terms}
    wrong = [name for name in given if not isinstance(name, str) or name in taken]
    if wrong or len(set(given)) < len(given):
        raise ParameterError(
            f"parameters are {list(given)}; expected names that are no quantity of the model and no term, each once"
        )
    return given


def _height(given: Any) -> int:
    """Rows of what may be an array, or -1."""
    many = given.ndim > 0 if isinstance(given, np.ndarray) else isinstance(given, list | tuple)
    return len(given) if many else -1


def _side_by_side(columns: Sequence[np.ndarray], rows: int) -> np.ndarray:
    """Shape (rows, n_columns); `np.column_stack` takes several times as long."""
    table = np.empty((rows, len(columns)))
    for j, column in enumerate(columns):
        table[:, j] = column
    return table


def at_nodes(rows: np.ndarray, horizon: int) -> np.ndarray:
    """Values at every stage and at the end, shape (horizon + 1, ...), from these, from those without the end, or one.

    >>> at_nodes(np.array([1.0, 2.0]), 2)
    array([1., 2., 2.])
    """
    if rows.ndim and len(rows) == horizon and len(rows) != 1 + horizon:
        return np.concatenate([rows, rows[-1:]])
    return rows if rows.ndim and len(rows) == horizon + 1 else np.broadcast_to(rows, (horizon + 1,))


def _checked_steps(steps: Sequence[int], horizon: int, dt: float) -> tuple[int, ...]:
    """Lengths of the stages as whole numbers.

    Raises
    ------
    ParameterError
        If they do not fit the horizon, or are no whole numbers of at least 1 that begin with 1.
    """
    given = list(steps)
    if len(given) != horizon:
        raise ParameterError(
            f"steps has {len(given)} entries; expected one for each of the {horizon} stages of the horizon"
        )
    if not all(isinstance(n, int | np.integer) and n >= 1 for n in given):
        raise ParameterError(
            f"steps is {given}; expected whole numbers of at least 1: how many of the model's steps of {dt:g} s each "
            "stage lasts"
        )
    if given[0] != 1:
        raise ParameterError(
            f"steps begins with {given[0]}; expected 1, because the controller plans anew every {dt:g} s: let the "
            "stages grow later"
        )
    return tuple(int(n) for n in given)


def _row(weights: Weights, names: tuple[str, ...]) -> np.ndarray:
    return np.array([weights.get(n, 0.0) for n in names], dtype=float)


def _rows(limits: Limits, names: tuple[str, ...]) -> np.ndarray:
    return np.array([limits.get(n, (-np.inf, np.inf)) for n in names], dtype=float).reshape(len(names), 2)
