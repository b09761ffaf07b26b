"""Problems of several parts as one that every solver takes: scenarios one behind the other, free parameters as states.

The states go through all scenarios in turn. After the end of each a stage that takes no time, a jump, puts them back to
where they are now, so that the horizon is as many times longer and no matrix is larger: what it costs to solve grows
with the number of scenarios, not with its cube. Inputs that are common are kept in further states while the first
scenario goes by, and are equations for the others. What is decided once is a state too, which a jump in front of
everything sets to an input of its own.

A Huber cost is the least over an excess ``o`` of ``w (e - o)^2 + 2 w d |o|``, with weight ``w`` and bend ``d``: the
excess over the bend, ``o / d``, is one more input of each stage, and the second part a soft limit of zero width. The
end of everything sees the last stage's inputs, so its excess is an input of its own.

For a solver that knows the curvature of the Lagrangian there are errors more, one for each state and input, which are
zero: what it writes in their derivatives adds to the curvature by states and inputs of that node, and to nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any
from uuid import uuid4

import casadi as ca
import numpy as np

from slipangle.models.model import Model
from slipangle.optimal.checks import is_numbers
from slipangle.optimal.extended import Extension, before, extended
from slipangle.optimal.ocp import OCP, Reference, at_nodes, middle

FLAT = 1e-3  # curvature by inputs without effect, which a jump has, per square of half their range
ZERO = "@zero"  # what errors that are zero are multiplied with
LAST = "@last"  # 1 at the end of everything, where a Huber cost reads the excess of the end


def own_parameters(ocp: OCP, names: Any) -> tuple[str, ...]:
    """Those of the names that are parameters of the model, not columns of the reference."""
    return tuple(n for n in names if n not in ocp.exogenous)


def rated(ocp: OCP) -> tuple[str, ...]:
    """Inputs whose rates are limited over a time that is decided, so that no bounds of their changes are known."""
    return () if ocp.duration is None else tuple(name for name in ocp.controls if name in ocp.rates)


def extended_model(ocp: OCP) -> Model:
    """The model with what is decided once and the common inputs as states, and parameters of scenarios as inputs."""
    s = ocp.scenarios
    extension = Extension(
        varied=() if s is None else own_parameters(ocp, s.values),
        constant=ocp.decided_once,
        free=own_parameters(ocp, ocp.free),
        span=None if ocp.duration is None else ocp.horizon * ocp.dt,
        held=() if s is None else tuple((name, f"@{i}") for i in range(s.common) for name in ocp.controls),
        before=rated(ocp),
    )
    return extended(ocp.model, extension) if extension.states or extension.inputs else ocp.model


class Joined(OCP):
    """The one problem that a problem with scenarios and free parameters is; what solvers read of it.

    Attributes
    ----------
    base : OCP
        The problem that it was made of.
    jumps : tuple of int
        Stages that take no time.
    starts : array of int, shape (n_scenarios,)
        Nodes at which the scenarios begin.
    share : array, shape (n_scenarios,)
        Their probabilities.
    which : array of int, shape (horizon + 1,)
        Scenario of each node.
    tied : bool
        Whether something at the end of a scenario depends on its last input, which is then that of the jump too.
    common : int
        How many of the first inputs are common.
    curved : int or None
        The first of the errors that are zero, None where there are none.
    """

    base: OCP
    starts: np.ndarray
    share: np.ndarray
    which: np.ndarray
    tied: bool
    common: int
    curved: int | None

    def __init__(self, base: OCP, *, curved: bool = False) -> None:
        # Long: what the solvers read, once each.
        n, s, once = base.horizon, base.scenarios, base.decided_once
        many, lead = 1 if s is None else len(s), int(bool(once))
        model = extended_model(base)
        fixed = tuple(p for p in base.parameters if p not in base.free)
        front = ("@front",) if lead and many > 1 else ()
        resets = tuple(f"@{name}" for name in base.model.states) if many > 1 else ()
        bends = (*(f"@bend of {name}" for name in base.huber), *((LAST,) if base.huber else ()))
        excesses = tuple(f"excess of {name}" for name in base.huber)
        total, nu = lead + many * (n + 1) - 1, len(base.controls)
        starts = lead + (n + 1) * np.arange(many)
        stage, node = np.arange(total), np.arange(total + 1)
        gaps = tuple(int(i) for i in (starts[1:] - 1))
        jumps = (*range(lead), *gaps)
        self.__dict__.update(
            base=base,
            model=model,
            horizon=total,
            steps=base.steps,
            controls=(*base.controls, *once, *excesses, *(f"last excess of {name}" for name in base.bent_at_end)),
            parameters=(*fixed, *resets, *front, *bends, *((ZERO,) if curved else ())),
            curved=len(base.tracked) if curved else None,
            identity=uuid4().hex,
            scenarios=None,
            free={},
            duration=None,
            huber={},
            jumps=jumps,
            starts=starts,
            common=0 if s is None else s.common,
            ends=starts + n,
            **{name: getattr(base, name) for name in ("Q", "R", "S", "terminal", "limits", "rates", "slack")},
            **{name: getattr(base, name) for name in ("slack_linear", "corridor", "terms", "terminal_limits")},
            **{name: getattr(base, name) for name in ("references", "headings")},
        )
        width = model.n_states + len(self.controls) if curved else 0
        self.__dict__["tracked"] = (*base.tracked, *(f"curvature {i}" for i in range(width)))
        self.__dict__["_counts"] = 1.0, 1.0, 1.0  # `spread` has counted them
        self.__dict__["soft"] = (*base.soft, *excesses)
        square, plain = base.slack_weights
        self.__dict__["slack_weights"] = (
            np.append(square, np.zeros(len(excesses))),
            np.append(plain, np.ones(len(excesses))),
        )
        first = base.model.n_states + len(once)
        held = model.states[first : first + self._n_held]
        more = (*excesses, *held, *(f"{way} of {name}" for name in rated(base) for way in ("rise", "fall")))
        self.__dict__["limited"] = (*base.limited, *more)
        self.__dict__["limited_along"] = np.append(base.limited_along, np.ones(len(more), dtype=bool))
        which = np.clip(np.searchsorted(starts, node, side="right") - 1, 0, None)
        share = np.ones(1) if s is None else s.probabilities
        each = base.excess_counts[np.where(node < lead, 0, node - starts[which])]
        self.__dict__["excess_counts"] = share[which] * each * (node >= lead)
        self.__dict__.update(which=which, share=share)
        self.__dict__["limited_at"] = self._limited_at(len(held))
        later = node + (node >= lead) * ~np.isin(node, self.ends)
        if lead:  # a stage is no step of the clock where its length is decided
            later = node if base.duration is not None else later
        self.__dict__["later_x"] = later
        last = np.isin(stage, [*(self.ends - 1), *jumps])
        self.__dict__["later_u"] = stage if lead and base.duration is not None else stage + ~last
        bounds = [base.input_bounds, *([[low, high]] for low, high in self._ranges)]
        self.__dict__["input_bounds"] = np.concatenate([np.asarray(b, dtype=float).reshape(-1, 2) for b in bounds])
        tied = self._tied()
        rates = np.full((total, len(self.controls), 2), [-np.inf, np.inf])
        for at in starts:
            rates[at : at + n, :nu] = base.step_bounds
            rates[at + 1 : at + n, [base.controls.index(name) for name in rated(base)]] = -np.inf, np.inf
        rates[starts[1:], :nu] = -np.inf, np.inf
        if lead and (base.S or base.rates):
            rates[0, :nu] = 0.0
        if tied:
            rates[list(gaps), :nu] = 0.0
        self.__dict__["step_bounds"] = rates
        self.__dict__["tied"] = tied
        limits = np.full((total + 1, len(self.limited), 2), 0.0)
        for at in starts:
            limits[at : at + n + 1, : len(base.limited)] = base.limits_at_nodes
        limits[:, len(self.limited) - 2 * len(rated(base)) :] = np.tile(
            [[-np.inf, 0.0], [0.0, np.inf]], (len(rated(base)), 1)
        )
        limits[~self.limited_at] = -np.inf, np.inf
        self.__dict__["limits_at_nodes"] = limits
        self.__dict__["stage_weights"] = self._spread(*base.stage_weights)

    # ---- sizes -------------------------------------------------------------------------------------------------

    @property
    def _n_held(self) -> int:
        s = self.base.scenarios
        return 0 if s is None else s.common * len(self.base.controls)

    @property
    def _ranges(self) -> list[tuple[float, float]]:
        """Limits of what is decided once, and of excesses, which have none."""
        base, free = self.base, (-np.inf, np.inf)
        once = [*base.free.values(), *([] if base.duration is None else [base.duration])]
        return [*once, *(free for _ in self.controls[len(base.controls) + len(once) :])]

    def _limited_at(self, held: int) -> np.ndarray:
        base, n = self.base, self.base.horizon
        own, first = len(base.limited), len(base.limited) + len(base.huber)
        at = np.zeros((self.horizon + 1, len(self.limited)), dtype=bool)
        for k, start in enumerate(self.starts):
            at[start : start + n + 1, :own] = base.limited_at
            at[start : start + n + 1, own:first] = True
            for j in range(held if k else 0):
                at[start + j // len(base.controls), first + j] = True
            at[start + 1 : start + n, first + held :] = True
        return at

    def _tied(self) -> bool:
        """Whether something at the end of a scenario depends on its last input."""
        base = self.base
        x, u, w, p = (ca.MX.sym(base.stage.name_in(i), base.stage.size1_in(i)) for i in range(4))
        if len(self.jumps) == 0:
            return False
        return any(ca.jacobian(v, u).nnz() > 0 for v in base.stage(x, u, w, p))

    def _spread(self, q: np.ndarray, r: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weights of the scenarios' errors, inputs and changes by their probabilities, for all stages."""
        n, nu, once = self.base.horizon, len(self.base.controls), len(self.base.decided_once)
        bent = nu + once + len(self.base.huber)
        low, high = self.input_bounds.T
        with np.errstate(invalid="ignore"):
            half = 0.5 * (high - low)
        flat = FLAT / np.where(np.isfinite(half) & (half > 0), half, 1.0) ** 2
        of_q = np.zeros((self.horizon + 1, len(self.tracked)))
        of_q[:, q.shape[1] :] = 1.0
        of_r, of_s = np.tile(flat, (self.horizon, 1)), np.zeros((self.horizon, len(self.controls)))
        for at, share in zip(self.starts, self.share, strict=True):
            of_q[at : at + n + 1, : q.shape[1]] = share * q
            of_r[at : at + n, :nu] = share * r
            of_s[at : at + n, :nu] = share * s
        starts = self.starts
        of_s[starts, :nu] = 0.0
        of_s[starts[0], :nu] = s[0]  # the first input is common, and so is its change
        if once:
            of_r[0, nu : nu + once] = 0.0
        counts = of_q[:, [self.tracked.index(name) for name in self.base.huber]] > 0
        of_r[:, nu + once : bent][counts[:-1]] = 0.0
        ends = [list(self.base.huber).index(name) for name in self.base.bent_at_end]
        of_r[-1, bent:][counts[-1, ends]] = 0.0
        if self.tied:
            gaps = [i for i in self.jumps if i >= starts[0]]
            of_r[gaps, :nu], of_s[gaps, :nu] = 0.0, flat[:nu]
        return of_q, of_r, of_s

    # ---- functions ---------------------------------------------------------------------------------------------

    def _beside(self, x: Any, w: Any) -> dict[str, Any]:
        varied = () if self.base.scenarios is None else own_parameters(self.base, self.base.scenarios.values)
        names = (*varied, *(n for n in self.base.parameters if n in self.exogenous))
        known = {name: w[self.exogenous.index(name)] for name in names}
        return {**known, **{name: x[self.model.states.index(name)] for name in self.base.decided_once}}

    def _more(self, x: Any, u: Any, w: Any) -> dict[str, Any]:
        base, states = self.base, self.model.states
        known = {name: x[states.index(name)] for name in base.decided_once}
        first = len(base.limited) + len(base.huber)
        for j, name in enumerate(self.limited[first : first + self._n_held]):
            known[name] = u[j % len(base.controls)] - x[states.index(name)]
        for name in rated(base):
            (low, high), change = base.rates[name], u[base.controls.index(name)] - x[states.index(before(name))]
            span = known["duration"] / base.horizon
            for way, rate in (("rise", high), ("fall", low)):
                known[f"{way} of {name}"] = change - rate * span if np.isfinite(rate) else 0 * change
        return known | {f"excess of {n}": self._price(n, w) * self._share(n, u, w) for n in base.huber}

    @property
    def _bendable(self) -> tuple[str, ...]:
        return self.base._bendable

    def _curved(self, x: Any, u: Any, w: Any) -> list[Any]:
        if self.curved is None:
            return []
        zero = w[self.exogenous.index(ZERO)]
        return [zero * (ca.sum1(x) + ca.sum1(u))] * (len(self.tracked) - self.curved)

    def _price(self, name: str, w: Any) -> Any:
        """What an excess as large as the bend costs."""
        return w[self.exogenous.index(f"@bend of {name}")]

    def _share(self, name: str, u: Any, w: Any) -> Any:
        """The excess over the bend."""
        here, last = u[self.controls.index(f"excess of {name}")], w[self.exogenous.index(LAST)]
        if name not in self.base.bent_at_end:
            return (1 - last) * here
        return (1 - last) * here + last * u[self.controls.index(f"last excess of {name}")]

    def _excess(self, name: str, u: Any, w: Any) -> Any:
        huber = self.base.huber
        return huber[name] * self._share(name, u, w) if name in huber else 0.0

    @cached_property
    def jump(self) -> ca.Function | None:  # type: ignore[override]
        """``(x, u, w) -> x`` after a stage that takes no time: in front of all, or between scenarios."""
        base = self.base
        if not self.jumps:
            return None
        x, u, w, _, _ = self.symbols(ca.SX)
        n, nu, once = base.model.n_states, len(base.controls), len(base.decided_once)
        back = ca.vertcat(*(w[self.exogenous.index(f"@{name}")] for name in base.model.states if self.ends.size > 1))
        if not once:
            later = ca.vertcat(back, x[n:, 0])
        elif self.ends.size == 1:
            later = ca.vertcat(x[:n], u[nu : nu + once], x[n + once :])
        else:
            front = w[self.exogenous.index("@front")]
            chosen = front * u[nu : nu + once] + (1 - front) * x[n : n + once]
            later = ca.vertcat(front * x[:n] + (1 - front) * back, chosen, x[n + once :])
        return ca.Function("jump", [x, u, w], [ca.densify(later)])

    def state_bounds(self, reference: Reference) -> np.ndarray:
        """Bounds of `limited` at each node, shape (horizon + 1, n_limited, 2); infinite where nothing is limited."""
        bounds = super().state_bounds(reference)
        bounds[~self.limited_at] = -np.inf, np.inf
        return bounds

    # ---- references --------------------------------------------------------------------------------------------

    def spread(self, x: np.ndarray, applied: np.ndarray, reference: Reference) -> Reference:
        """What is wanted of the base problem, from the state and the input now on, for all scenarios."""
        base, n = self.base, self.base.horizon
        s, once = base.scenarios, base.decided_once
        w = np.zeros((self.horizon + 1, len(self.exogenous)))
        at = self.exogenous.index
        usual = at_nodes(np.asarray(reference.exogenous, dtype=float), n)
        wanted, node = np.zeros((self.horizon + 1, len(self.references))), np.arange(self.horizon + 1)
        corridor = np.tile([np.inf, np.inf], (self.horizon + 1, 1))
        inputs = np.tile(self.resting(applied), (self.horizon, 1))
        limits = self.limits_at_nodes.copy()
        own = base.limits_at_nodes if reference.limits is None else np.asarray(reference.limits)
        named = () if s is None else tuple(s.values)
        values: Any = () if s is None else np.transpose([*s.values.values()])
        if reference.scenarios is not None:
            values = reference.scenarios.transpose(0, 2, 1)
        for k, start in enumerate(self.starts):
            rows = slice(start, start + n + 1)
            for j, name in enumerate(base.exogenous):
                if name in self.exogenous:
                    w[rows, at(name)] = usual[:, j]
            for j, name in enumerate(named):
                w[rows, at(name)] = values[k][j]
            wanted[rows] = reference.tracked
            inputs[start : start + n, : len(base.controls)] = 0.0 if reference.inputs is None else reference.inputs
            limits[rows, : len(base.limited)] = own
            if reference.corridor is not None:
                corridor[rows] = reference.corridor
        for i in range(0 if s is None else s.common):
            w[self.starts[0] + i, at(f"@{i}")] = 1.0
        if once:  # a jump in front; what is there counts nowhere
            w[0], wanted[0] = w[1], wanted[1]
        for name, value in zip(base.model.states, x, strict=True):
            if f"@{name}" in self.exogenous:
                w[:, at(f"@{name}")] = value
        if "@front" in self.exogenous:
            w[:, at("@front")] = node == 0
        limits[~self.limited_at] = -np.inf, np.inf
        q, r, c = self._spread(*base.weights_for(reference))
        for name, bend in base.huber.items():
            weight, counts = q[:, self.tracked.index(name)], self.excess_counts
            w[:, at(f"@bend of {name}")] = 2 * bend**2 * weight / np.where(counts > 0, counts, 1.0)
        if base.huber:
            w[-1, at(LAST)] = 1.0
        lanes = corridor if base.corridor is not None else None
        return Reference(tracked=wanted, exogenous=w, inputs=inputs, corridor=lanes, limits=limits, Q=q, R=r, S=c)

    def resting(self, applied: np.ndarray) -> np.ndarray:
        """Inputs where they have no effect, shape (n_controls,): as applied before, and in the middle."""
        middles = [middle(low, high) for low, high in self._ranges]
        return np.clip([*applied, *middles], self.input_bounds[:, 0], self.input_bounds[:, 1])

    def state(self, x: np.ndarray) -> np.ndarray:
        """The state now with what is added, which is zero."""
        return np.concatenate([x, np.zeros(self.model.n_states - len(x))])

    def guess(self, reference: Reference, decided: Mapping[str, float] | None = None) -> np.ndarray:
        """First values of what is decided once, shape (n_once,): those that are given, if they are numbers."""
        base, given, values = self.base, decided if isinstance(decided, Mapping) else {}, []
        for name, (low, high) in zip(base.decided_once, self._ranges, strict=False):
            if is_numbers(np.asarray(given.get(name)), ()):
                values.append(float(np.clip(given[name], low, high)))
            elif name in base.exogenous:
                values.append(float(np.asarray(reference.exogenous)[0, base.exogenous.index(name)]))
            elif name == "duration":
                values.append(middle(*base.duration) if base.duration else 0.0)
            else:
                model: Any = base.model
                values.append(float(model.value(name)))
        return np.array(values)
