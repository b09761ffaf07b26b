"""`Ode`: a model from equations of your own."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self

import casadi as ca
import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, nearest, place
from slipangle.models.equations import Recorded
from slipangle.models.implicit import Guess, Unknowns
from slipangle.models.ode import OdeModel
from slipangle.models.parameters import ParameterSet, require_in_range
from slipangle.ops import Scalar, Vector, is_symbolic, is_traced, stack
from slipangle.units import SI

Equations = Callable[..., Any]  # (x, u, p) -> rates; more arguments where equations are solved
Signals = Callable[..., Mapping[str, Scalar]]  # (x, u, p) -> more outputs


@dataclass(frozen=True)
class NamedParams(ParameterSet):
    """Parameters that are named when the program runs, instead of by a class; each is an attribute too.

    >>> p = NamedParams.of({"stiffness": (2e4, SI("N/m", "spring", 1.0, 1e6)), "damping": (1e3, 0.0, 1e5)})
    >>> p.damping, p.si("stiffness").unit
    (1000.0, 'N/m')
    """

    names: tuple[str, ...]
    values: tuple[float, ...]
    units: tuple[str, ...]
    docs: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        lengths = {f.name: len(getattr(self, f.name)) for f in fields(self)}
        if len(set(lengths.values())) != 1 or len(set(self.names)) != len(self.names):
            raise ParameterError(f"{lengths} of {list(self.names)}; expected one of each per name, and each name once")
        for name in self.names:
            if not name.isidentifier() or hasattr(type(self), name) or name in lengths:
                raise ParameterError(f"{name!r} cannot name a parameter; expected a word such as 'stiffness'")
        for name, value, meta in zip(self.names, self.values, self.metadata().values(), strict=True):
            require_in_range(name, value, meta)

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """From a value by name: a number, ``(value, SI(...))`` or ``(value, lower, upper)``."""
        values, metas = [], []
        for name, content in given.items():
            parts = content if isinstance(content, Sequence) else (content,)
            value, rest = parts[0], tuple(parts[1:])
            if rest and isinstance(rest[0], SI) and len(rest) == 1:
                meta = rest[0]
            elif len(rest) in (0, 2) and not any(isinstance(r, SI) for r in rest):
                meta = SI("-", name, *map(float, rest))
            else:
                raise ParameterError(
                    f"the parameter '{name}' is given as {content!r}; expected a number, (value, SI(unit, meaning, "
                    "lower, upper)) or (value, lower, upper)"
                )
            values.append(float(value))
            metas.append(meta)
        columns = {"units": "unit", "docs": "doc", "lower": "lower", "upper": "upper"}
        about = {name: tuple(getattr(meta, of) for meta in metas) for name, of in columns.items()}
        return cls(names=tuple(given), values=tuple(values), **about)

    def __getattr__(self, name: str) -> Any:
        names = self.__dict__.get("names", ())
        if name in names:
            return self.values[names.index(name)]
        raise AttributeError(f"there is no parameter '{name}'; {nearest(name, names)}")

    def metadata(self) -> dict[str, SI]:  # type: ignore[override]  # of this set, not of the class
        """`SI` of every parameter, in order."""
        rows = zip(self.names, self.units, self.docs, self.lower, self.upper, strict=True)
        return {name: SI(unit, doc, lower, upper) for name, unit, doc, lower, upper in rows}

    def si(self, name: str) -> SI:  # type: ignore[override]  # of this set, not of the class
        """`SI` of one parameter."""
        known = self.metadata()
        if name not in known:
            raise ParameterError(f"there is no parameter '{name}'; {nearest(name, known)}: use one of these names")
        return known[name]

    def with_values(self, **values: Any) -> Self:
        """A copy with some values replaced (numbers or symbols)."""
        for name in values:
            self.si(name)
        changed = (values.get(n, v) for n, v in zip(self.names, self.values, strict=True))
        return replace(self, values=tuple(changed))


@dataclass(frozen=True, kw_only=True)
class Ode(OdeModel):
    """A model from equations of your own: simulated, fitted, controlled with and compiled like the built-in ones.

    Raises ParameterError if ``f`` gives another number of rates, or cannot work on symbols, or if equations
    leave a rate open, or a name is there twice.

    Parameters
    ----------
    f : callable, optional
        ``f(x, u, p)``, the rates of the states as a list; ``x[0]`` is the first state, ``u[0]`` the first input,
        ``p.stiffness`` a parameter. Elementary functions come from `slipangle.ops`, so that the equations work on
        symbols too.
    states, inputs : tuple of str
        Their names.
    params : ParameterSet, or mapping
        The parameters; a mapping gives each as a number, ``(value, lower, upper)`` or ``(value, SI(unit, meaning,
        lower, upper))``.
    dt : float
        Sample time. [s]
    outputs : tuple of str
        Which states, or signals of ``more``, are the outputs; by default all states.
    more : callable, optional
        ``more(x, u, p)``, further signals by name, such as ``{"a_y": ...}``.
    begin : mapping, optional
        Initial value of states that the data have no channel for, SI units; by default 0.
    implicit : callable, optional
        ``implicit(x_dot, x, u, p)`` in place of ``f``: residuals, one for each state, that are zero.
    algebraic : callable, optional
        ``algebraic(x, z, u, p)``: residuals that are zero, one for each algebraic variable z. The other functions then
        take z behind x too: ``f(x, z, u, p)``, ``more(x, z, u, p)``, ``implicit(x_dot, x, z, u, p)``.
    guess : mapping of str to float or callable
        The algebraic variables by name, each with the value [SI] from which Newton's method begins, or a function
        ``(x, u, p)`` of it. They may be outputs.
    newton : int
        Newton steps that solve these equations, at each evaluation of the rates; equations that are straight lines in
        the unknowns are solved at once. Where the last step is no small one the rates are NaN.
    method, substeps
        As for every `OdeModel`; explicit steps are at most 10 ms long unless ``substeps`` says otherwise. In a
        controller each is code of its own, so that a sample time above 4 s, as of a tank or a building, needs
        ``substeps`` there: about four to the shortest time constant; or ``method="radau"``.

    Notes
    -----
    A file cannot keep a function, but the operations that it makes: save ``model.recorded()``. Loaded again it gives
    the same numbers.

    Algebraic equations must determine z (index 1), implicit ones x_dot: differentiate constraints by time until then.

    >>> tank = Ode(
    ...     f=lambda x, u, p: [(u[0] - p.leak * x[0]) / p.area],
    ...     states=("level",), inputs=("flow",), params={"area": (2.0, 0.1, 10.0), "leak": 0.5}, dt=0.1,
    ... )
    >>> round(float(tank.step([1.0], [0.5])[0]), 9)
    1.0
    """

    f: Equations | None = None
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    more: Signals | None = None
    begin: Mapping[str, float] = field(default_factory=dict)
    implicit: Equations | None = field(default=None, metadata={"may be missing in a file": True})
    algebraic: Equations | None = field(default=None, metadata={"may be missing in a file": True})
    guess: Mapping[str, Guess] = field(default_factory=dict, metadata={"may be missing in a file": True})
    newton: int = field(default=8, metadata={"may be missing in a file": True})

    def __post_init__(self) -> None:
        for key in ("states", "inputs"):
            given = getattr(self, key)
            object.__setattr__(self, key, (given,) if isinstance(given, str) else tuple(given))
        names = (*self.states, *self.inputs, *self.guess)
        if len(set(names)) < len(names):
            raise ParameterError(
                f"states, inputs and algebraic variables are named {list(names)}; expected each name once: rename "
                f"'{next(n for i, n in enumerate(names) if n in names[:i])}'"
            )
        if isinstance(self.params, Mapping):
            object.__setattr__(self, "params", NamedParams.of(self.params))
        object.__setattr__(self, "begin", dict(self.begin))
        for name in self.begin:
            if name not in self.states:
                raise ParameterError(f"begin names '{name}'; {nearest(name, self.states)}: expected a state")
        object.__setattr__(self, "guess", dict(self.guess))
        if (self.f is None) == (self.implicit is None):
            raise ParameterError(
                f"{'both' if self.f is not None else 'neither'} of f and implicit are given; expected the rates "
                "f(x, u, p), or equations of them: implicit(x_dot, x, u, p)"
            )
        if (self.algebraic is None) == bool(self.guess):
            raise ParameterError(
                f"algebraic is {self.algebraic!r} and guess {self.guess}; expected both: equations "
                "algebraic(x, z, u, p), and for each z its name and a first value"
            )
        if not (isinstance(self.newton, int) and self.newton >= 1):
            raise ParameterError(f"newton is {self.newton!r}; expected a whole number of steps of at least 1")
        for key in self._given:
            if not callable(getattr(self, key)):
                raise ParameterError(
                    f"{key} is {getattr(self, key)!r}; expected a function {key}({', '.join((*self._sizes(key), 'p'))})"
                )
        params: Any = self.params
        if not any(is_symbolic(v) or is_traced(v) for v in (getattr(params, name) for name in params.metadata())):
            self._check_equations()
        super().__post_init__()

    def __hash__(self) -> int:
        functions = self.f, self.more, self.implicit, self.algebraic, tuple(self.guess)
        return hash((*functions, self.states, self.inputs, self.params, self.dt, self.outputs, self.method))

    def __getstate__(self) -> dict[str, Any]:
        """As of every model; functions that no other process could find by name are written down, see `recorded`."""
        kept = super().__getstate__()
        for key in self._given:
            if "<" in getattr(kept[key], "__qualname__", ""):
                kept[key] = Recorded.of(kept[key], self.params, **self._sizes(key))
        kept["guess"] = {n: self._kept_guess(g, "<" in getattr(g, "__qualname__", "")) for n, g in self.guess.items()}
        return kept

    @property
    def _given(self) -> tuple[str, ...]:
        """Which functions there are."""
        return tuple(key for key in ("f", "more", "implicit", "algebraic") if getattr(self, key) is not None)

    def _sizes(self, key: str) -> dict[str, int]:
        """Arguments of a function before the parameters, and their lengths."""
        n = len(self.states)
        sizes = {"x_dot": n, "x": n, "z": len(self.guess), "u": len(self.inputs)}
        without = {*(() if key == "implicit" else ("x_dot",)), *(() if self.guess else ("z",))}
        return {name: count for name, count in sizes.items() if name not in without}

    def _kept_guess(self, guess: Any, written: bool) -> Any:
        """A guess that a file keeps: a function written down."""
        if not (written and callable(guess)):
            return guess
        return Recorded.of(lambda *given: [guess(*given)], self.params, x=self.n_states, u=self.n_inputs)

    def _check_equations(self) -> None:
        x, u = ca.SX.sym("x", self.n_states), ca.SX.sym("u", self.n_inputs)
        needs = (
            "expected x[i], u[i], p.name, arithmetic and functions of slipangle.ops, such as ops.sin and ops.where: "
            f"see {place(self.f or self.implicit)}"
        )
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                rates = self._rates(x, u)
                self.signals(x, u)
        except ParameterError:
            raise
        except Exception as error:
            said = str(error).strip().partition("\n")[0]
            raise ParameterError(f"the equations fail on symbols ({type(error).__name__}: {said}); {needs}") from error
        n = rates.numel() if is_symbolic(rates) else len(rates)
        if n != self.n_states:
            raise ParameterError(
                f"f gives {n} rates for the {self.n_states} states {list(self.states)}; expected one for each, in order"
            )
        at = 0.3 + 0.1 * np.arange(self.n_states + self.n_inputs)
        x_at, u_at = at[: self.n_states], at[self.n_states :]
        symbolic = ca.Function("f", [x, u], [rates if is_symbolic(rates) else ca.vertcat(*rates)])(x_at, u_at)
        numeric = np.asarray(self.derivative(x_at, u_at), dtype=float)
        if not np.allclose(np.asarray(symbolic).ravel(), numeric, rtol=1e-9, atol=1e-12, equal_nan=True):
            raise ParameterError(f"f gives other rates on symbols than on numbers; {needs}")

    def resampled(self, dt: float, *, substeps: int = 0, outputs: tuple[str, ...] = ()) -> Self:
        """The same equations at another sample time [s], in steps that are no longer; see `Parametrised.resampled`."""
        kept = 1 if self.method == "radau" else max(1, math.ceil(self.substeps * dt / self.dt - 1e-9))
        return replace(self, dt=dt, substeps=max(substeps, kept), outputs=outputs or self.outputs)

    def recorded(self) -> Self:
        """The same model with its equations written down operation by operation, which `save` can keep.

        Raises ParameterError if they hold an operation that cannot be written down.
        """
        written: dict[str, Any] = {
            key: Recorded.of(getattr(self, key), self.params, **self._sizes(key)) for key in self._given
        }
        return replace(self, **written, guess={n: self._kept_guess(g, True) for n, g in self.guess.items()})

    @cached_property
    def _unknowns(self) -> Unknowns | None:
        """What is solved for, None where nothing is."""
        if self.implicit is None and self.algebraic is None:
            return None
        return Unknowns(
            self.implicit,
            self.algebraic,
            n_states=self.n_states,
            n_inputs=self.n_inputs,
            guess={n: _first(g) if isinstance(g, Recorded) else g for n, g in self.guess.items()},
            params=self.params,
            newton=self.newton,
        )

    def _rates(self, x: Vector, u: Vector) -> Any:
        """Rates, as the functions give them."""
        if self._unknowns is None or (self.f is not None and not self.guess):
            return self.f(x, u, self.params)  # type: ignore[misc]
        rates, z = self._unknowns.solve(x, u, self.params)
        return rates if self.f is None else self.f(x, z, u, self.params)

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """The rates that ``f`` gives, or that solve the equations."""
        rates = self._rates(x, u)
        return rates if is_symbolic(rates) or isinstance(rates, np.ndarray) else stack(list(rates))

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Algebraic variables, and what ``more`` gives."""
        if not self.guess or self._unknowns is None:
            return {} if self.more is None else dict(self.more(x, u, self.params))
        z = self._unknowns.solve(x, u, self.params)[1]
        known = {name: z[i] for i, name in enumerate(self.guess)}
        return known if self.more is None else {**known, **self.more(x, z, u, self.params)}

    def _start(self, name: str, data: Dataset) -> float:
        return super()._start(name, data) if name in data else float(self.begin.get(name, 0.0))


def _first(recorded: Recorded) -> Callable[[Vector, Vector, Any], Scalar]:
    return lambda *given: recorded(*given)[0]
