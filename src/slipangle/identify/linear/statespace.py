"""State space from data in one call: subspace start, order by cross-validation, prediction-error refinement."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ParameterError, SlipangleError
from slipangle.fields import Radius, Whole, Within
from slipangle.identify.linear.delays import delayed
from slipangle.identify.linear.estimator import criteria
from slipangle.identify.linear.inside import Held, fitted, follows, held_said, outside
from slipangle.identify.linear.neighbours import Chosen
from slipangle.identify.linear.order_search import (
    FINISHED,
    HOPELESS,
    ROUGH,
    TIE,
    Effort,
    Judged,
    OrderChoice,
    searched,
)
from slipangle.identify.linear.pem import PEM, Focus, Offsets
from slipangle.identify.linear.predictor import Work
from slipangle.identify.linear.scales import ScaledEstimator, Scales, weighed
from slipangle.identify.linear.statespace_unstable import ahead_if_unstable
from slipangle.identify.linear.subspace import Algorithm, ObliqueProjection, Subspace, project
from slipangle.identify.linear.waiting import said, settled, waiting
from slipangle.identify.stability import breakdown_said, later, noted
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.model import Candidate
from slipangle.models.plausible import growth
from slipangle.numerics.blas import one_blas_thread

Order = Annotated[int, Within(1, 200)]


@dataclass(frozen=True, kw_only=True)
class StateSpace(ScaledEstimator):
    """State-space estimator: `Subspace`, then `PEM`; where the order is open, `choose_order` settles it.

    A free-run fit without a limit on the poles can end at a model whose free run holds only from the very initial
    state that was estimated along. Where it goes astray from the training data's first samples, the fit is made again
    with ``max_radius=1``, and says so. Where the order is open and a fit that is compared has a pole outside the unit
    circle, as drifts and offsets of the data make them, that order is refined with ``max_radius=1`` too, and that is
    taken unless free runs over held-out data are worse by it. Where no stable model predicts the data as well one step
    ahead as an unstable one, beyond chance, that is returned, and said: free runs are no way to it.

    Parameters
    ----------
    order : int or tuple of int
        Number of states, or candidates of which cross-validation chooses one; the model's ``fit_info.candidates`` are
        all that were compared.
    focus : {"simulation", "prediction"}
        What is minimised, and by what orders are compared: the free-run error with K = 0, or the one-step-ahead error
        with K free.
    direct : bool or "chosen", optional
        Whether outputs depend on inputs of the same sample; by default not where the order is given. Where it is
        chosen, so are delays of more than 4 samples, which are then no part of the order: inputs wait for them in
        states of their own. What the data tell of either (`slipangle.identify.linear.delays.first_effects`) is taken
        where free runs of subspace models over held-out data are better for it.
    algorithm, block_rows
        See `Subspace`.
    offsets, weights, max_radius, max_iterations
        See `PEM`; numbers as weights are the typical error of each output, in its unit.
    memory : int
        Samples from which the model reads its initial state; 0 for ``3 order + 3``.
    holdout : float
        Share of a single record, at its end, on which orders are compared [-]; several experiments take turns.
    """

    order: Order | tuple[Order, ...] = tuple(range(1, 9))
    focus: Focus = "simulation"
    algorithm: Algorithm = "cva"
    block_rows: int | None = None
    direct: bool | Chosen | None = None
    offsets: Offsets = "none"
    weights: Literal["residual", "output"] | tuple[float, ...] = "residual"
    max_radius: Radius | None = None
    memory: Whole = 0
    holdout: Annotated[float, Within(0, 1, open="both", example="0.25")] = 0.25
    max_iterations: Whole = 100

    def __post_init__(self) -> None:
        if self.direct is None:
            object.__setattr__(self, "direct", "chosen" if isinstance(self.order, tuple) else False)
        super().__post_init__()
        if self.order == ():
            raise ParameterError("order is (); expected a whole number of at least 1, or several of them")

    _what = "the state space"

    def _within(self, scales: Scales) -> StateSpace:
        return replace(self, weights=weighed(self.weights, scales))

    def _scaled_fit(self, data: Dataset) -> StateSpaceModel:
        began = time.perf_counter()
        if self.direct == "chosen":
            settings, waits = settled(self, data)
            model = waiting(settings._scaled_fit(delayed(data, waits)), waits, data)
            return _told(model, said(bool(settings.direct), waits), began)
        if isinstance(self.order, int):
            return ahead_if_unstable(self, self._usable(data, self.order), data)
        choice, model = fitted(self, data, self._compared(data))
        model = noted(model, later(model.poles, data)) if self.focus == "simulation" else model
        model = noted(model, held_said(model, choice))
        return ahead_if_unstable(self, _told(model, f"{choice.said}; ", began, candidates=choice.candidates), data)

    @property
    def _orders(self) -> tuple[int, ...]:
        return (self.order,) if isinstance(self.order, int) else tuple(sorted(set(self.order)))

    def _lasting(self, data: Dataset, choice: OrderChoice) -> tuple[OrderChoice, StateSpaceModel]:
        """The fit of the chosen order, or of the next best in free runs where its own run away and those do not.

        One that runs away only over more than an experiment gives way to no order that is out of question.
        """
        chosen = self._usable(data, choice.order)
        soon = growth(chosen.poles, data.n_longest)
        longest = data.n_longest if soon else data.n_samples
        if not growth(chosen.poles, longest):
            return choice, chosen
        others = sorted(choice.candidates, key=lambda c: c.error)
        most = 1.0 if soon else min(1.0, HOPELESS * min((c.error for c in others), default=1.0))
        for other in others:
            order = int(other.orders.rpartition(" ")[2])
            if order == choice.order or not (other.stable and other.error < most):
                continue
            model = self._usable(data, order)
            if not growth(model.poles, longest):
                table = sorted(choice.candidates, key=lambda c: c is not other)
                return replace(choice, order=order, candidates=tuple(table)), model
        return choice, chosen

    def _usable(self, data: Dataset, order: int) -> StateSpaceModel:
        """The fit, with its poles held where a free-run fit cannot run freely over its own data."""
        model = self._of_order(data, order)
        size = float(np.abs(model.poles).max())
        if self.focus != "simulation" or self.max_radius is not None or size <= 1 or follows(model, data):
            return model
        within = replace(self, max_radius=1.0)._of_order(data, order)
        if not follows(within, data):
            return noted(model, _ASTRAY.format(size=size, what="no stable one does better"))
        return noted(within, _ASTRAY.format(size=size, what="the poles were held inside the unit circle"))

    def choose_order(self, data: Dataset) -> OrderChoice:
        """Compare the candidate orders on data that their fits have not seen.

        Subspace models of all orders come from one factorisation. From the smallest order that predicts almost like the
        best of them on, orders are refined as long as one more helps, or one less does no harm, and those whose start
        is better by two standard errors of the difference over stretches of the held-out data.

        Of several experiments, the models without each group come from those of all, by the steps from one optimum to
        the other; in flat valleys they still know a little of the group, and go on where the choice hangs by it.

        All refinements together take at most the work of 5 fits, where one fit is `fit` with the chosen order given and
        work the samples over which errors, and each of their derivatives, are run: the same on every machine. Where
        drifts make poles outside the unit circle, so that an order is refined twice, it was 5.2 to 6.5 on 5 of 40
        records. Orders that would go beyond are not refined, and those that are not refined are not chosen. Subspace
        models and runs over held-out data, by which a direct path and delays are settled too, come on top; of a few
        hundred samples they take as long as a fit or two.

        Raises ParameterError if no candidate could be fitted; the reasons are given.
        """
        scales = Scales.of(data)
        settings, waits = self._within(scales), dict.fromkeys(data.inputs, 0)
        if self.direct == "chosen":
            settings, waits = settled(settings, scales.data)
        choice = settings._compared(delayed(scales.data, waits))
        return replace(choice, direct=bool(settings.direct), waits=tuple(waits.values()))

    def _compared(self, data: Dataset) -> OrderChoice:
        orders = self._orders
        seen, parts, holdout = self._held_out(data)
        failures: dict[int, str] = {}
        starts, projection = self._starts(seen, parts, orders, failures)
        judged: dict[int, Judged] = {}
        effort, held = self._effort(orders, data, seen), Held(self)

        def judge(at: int, least: float | None, tolerance: float = ROUGH, most: float = np.inf) -> float:
            order = orders[at]
            if order not in starts:
                return np.inf
            try:
                with breakdown_said("the state space", data), one_blas_thread():
                    if least is None:
                        judged[order] = self._judged(*starts[order], parts)
                        return judged[order].error
                    known = judged.get(order, starts[order][0])

                    def refine(how: StateSpace, left: float) -> Judged:
                        return how._refined(known, seen, parts, least, tolerance, effort.begin(left))

                    judged[order] = held.better(order, refine, most)
                    effort.went_on(at, judged[order].work)
            except SlipangleError as reason:
                failures.setdefault(order, f"order {order}: {reason}")
                return np.inf
            return judged[order].error

        rows = seen.n_samples * len(seen.outputs)
        shares = [2 * self._n_parameters(o, seen) / rows if len(parts) > 1 else 0.0 for o in orders]

        def alike(at: int, of: int) -> float:
            one, other = (judged.get(orders[i]) for i in (at, of))
            return TIE if one is None or other is None else one.alike(other)

        errors, refined, place = searched(judge, shares, effort, alike)
        if not np.isfinite(errors).any():
            raise ParameterError(f"no order among {list(orders)} could be fitted; {next(iter(failures.values()))}")
        best = orders[place]
        if len(parts) == 1 and best in judged:
            judged[best] = held.of(best)._finished(judged[best], seen, parts, effort.begin(np.inf))
        at = dict(zip(orders, errors, strict=True))
        if projection is None or len(parts) == 1:
            start = Subspace(order=max(orders), algorithm=self.algorithm, block_rows=self.block_rows)
            given: Any = {"algorithm": self.algorithm, "block_rows": start.rows(data)}
            projection = project(data, offset=self.offsets != "none", **given)
        return OrderChoice(
            orders=orders,
            errors=errors,
            singular_values=projection.singular_values,
            order=best,
            holdout=holdout,
            failures=tuple(failures[o] for o in orders if o in failures),
            refined=tuple(orders[i] for i in refined),
            inside=held.of(best) is not self,
            outside=best in judged and outside(judged[best]),
            candidates=self._table(judged, sorted(judged, key=lambda o: (o != best, at[o])), seen, parts),
        )

    def _effort(self, orders: Sequence[int], data: Dataset, seen: Dataset) -> Effort:
        """What one linearisation costs of every order."""
        columns = [1 + order + order**2 + self._n_parameters(order, seen) for order in orders]
        return Effort([seen.n_samples * c for c in columns], data.n_samples / seen.n_samples)

    def _judged(
        self, model: StateSpaceModel, models: Sequence[StateSpaceModel], parts: Sequence[Dataset], work: float = 0.0
    ) -> Judged:
        runs = [self._squares(m, part, self.focus) for m, part in zip(models, parts, strict=True)]
        return Judged.of(model, models, runs, work)

    def _refined(
        self,
        known: Judged | StateSpaceModel,
        seen: Dataset,
        parts: Sequence[Dataset],
        least: float,
        tolerance: float,
        work: Work,
    ) -> Judged:
        """An order's models, from a start or what is known, refined as far as tells them from the least error's."""
        start, error = (known.model, known.error) if isinstance(known, Judged) else (known, np.inf)
        if isinstance(known, Judged) and tolerance == FINISHED:
            return self._finished(known, seen, parts, work)

        def refined(start: StateSpaceModel, tolerance: float) -> Judged:
            pem = self._pem(start, _STEPS)
            if len(parts) > 1:
                whole, without, took = pem.refined_without(parts, max(tolerance, _FAR), tolerance < ROUGH, work)
                return self._judged(whole, without, parts, took)
            before, model = work.done, pem.refined(seen, tolerance, work)
            return self._judged(model, [model], parts, work.done - before)

        if error <= HOPELESS * least:
            return refined(start, tolerance)
        found = refined(start, _LOOSE)
        if found.error > HOPELESS * least or work.used_up:
            return found
        again = refined(found.model, tolerance)
        return again._replace(work=found.work + again.work)

    def _table(
        self, judged: Mapping[int, Judged], orders: Sequence[int], seen: Dataset, parts: Sequence[Dataset]
    ) -> tuple[Candidate, ...]:
        """What came out for the orders."""
        found = []
        for order in orders:
            try:
                with breakdown_said("the state space", seen), one_blas_thread():
                    found.append(self._candidate(order, judged[order], seen, parts))
            except SlipangleError:  # a start that does not last over its own data
                continue
        return tuple(found)

    def _candidate(self, order: int, judged: Judged, seen: Dataset, parts: Sequence[Dataset]) -> Candidate:
        model, other = judged.model, "simulation" if self.focus == "prediction" else "prediction"
        free = ahead = judged.squares
        if any(np.any(m.K) for m in judged.models):  # without K they are the same
            others = np.array([self._errors(m, p, other) for m, p in zip(judged.models, parts, strict=True)])
            free, ahead = (free, others) if self.focus == "simulation" else (others, ahead)
        run = model._predict(seen) if np.any(model.K) else model._simulate(seen)
        left = run.error[run.predicted] / np.std(seen.y, axis=0)
        n, d = len(left), self._n_parameters(order, seen)
        log_det = float(np.linalg.slogdet(left.T @ left / n)[1])
        return Candidate(
            orders=f"order = {order}",
            n_parameters=d,
            error=float(np.mean(np.sqrt(np.mean(free, axis=0)))),
            one_step_error=float(np.mean(np.sqrt(np.mean(ahead, axis=0)))),
            **criteria(log_det, d, n),
            stable=not any(growth(m.poles, seen.n_longest) for m in (model, *judged.models)),
        )

    def _n_parameters(self, order: int, data: Dataset) -> int:
        """What the data determine of a model, whatever its basis."""
        nu, ny = len(data.inputs), len(data.outputs)
        d = order * (ny + nu) + ny * nu * bool(self.direct) + order * ny * (self.focus == "prediction")
        return d + {"none": 0, "output": ny, "input": nu, "both": nu + ny}[self.offsets]

    def _starts(
        self, seen: Dataset, parts: Sequence[Dataset], orders: tuple[int, ...], failures: dict[int, str]
    ) -> tuple[dict[int, tuple[StateSpaceModel, list[StateSpaceModel]]], ObliqueProjection | None]:
        """Subspace models of all orders from one factorisation, that of the largest order which the data allow."""
        found: dict[int, tuple[StateSpaceModel, list[StateSpaceModel]]] = {}
        projection = None
        for order in reversed(orders):
            try:
                with breakdown_said("the state space", seen), one_blas_thread():
                    subspace = self._subspace(order)
                    projection = subspace.projected(seen) if projection is None else projection
                    if len(parts) > 1:
                        found[order] = subspace.left_out(projection, parts)
                    else:
                        model = subspace.of(projection, seen)
                        found[order] = model, [model]
            except SlipangleError as reason:
                failures.setdefault(order, f"order {order}: {reason}")
        return found, projection

    def _held_out(self, data: Dataset) -> tuple[Dataset, list[Dataset], str]:
        """What is fitted to, the parts that are held out in turn, and these in words."""
        parts = data.experiments
        if len(parts) == 1:
            train, test = data.split(1 - self.holdout)
            return train, [test], f"the last {100 * self.holdout:g} % of the record"
        n = min(5, len(parts))
        groups = [join(*parts[i::n]) for i in range(n)]
        return join(*groups), groups, f"each of {n} groups of experiments in turn"

    @staticmethod
    def _squares(model: StateSpaceModel, part: Dataset, focus: Focus) -> tuple[np.ndarray, np.ndarray]:
        """Squared errors in units of the outputs' variances, shape (n_samples, n_outputs), and which are predicted."""
        run = model._simulate(part) if focus == "simulation" else model._predict(part)
        return run.error**2 / np.var(part.y, axis=0), run.predicted

    @classmethod
    def _errors(cls, model: StateSpaceModel, part: Dataset, focus: Focus) -> np.ndarray:
        """Means of these, shape (n_outputs,)."""
        squares, known = cls._squares(model, part, focus)
        return np.mean(squares[known], axis=0)

    def _of_order(self, data: Dataset, order: int) -> StateSpaceModel:
        start = self._subspace(order)._fit(data)
        refined = self._pem(start, self.max_iterations)._fit(data)
        info, first = refined.fit_info, start.fit_info
        if info is not None and first is not None:
            info = replace(info, method=f"{info.method}; start: {first.method}")
        return replace(refined, fit_info=info, memory=self.memory or refined.memory)

    def _subspace(self, order: int) -> Subspace:
        given: Any = {name: getattr(self, name) for name in ("algorithm", "block_rows", "direct")}
        return Subspace(order=order, offset=self.offsets != "none", disturbance=self.focus == "prediction", **given)

    def _finished(self, rough: Judged, seen: Dataset, parts: Sequence[Dataset], work: Work) -> Judged:
        """The model of all that is seen refined to the end, or as it was where that fails."""
        try:
            with breakdown_said("the state space", seen):
                model = self._pem(rough.model, _STEPS).finished(seen, work)
                if len(parts) > 1:
                    return rough._replace(model=model, work=work.done)
                return self._judged(model, [model], parts, work.done)
        except SlipangleError:
            return rough._replace(work=work.done)

    def _pem(self, start: StateSpaceModel, steps: int) -> PEM:
        shared: Any = {name: getattr(self, name) for name in ("focus", "offsets", "direct", "weights", "max_radius")}
        return PEM(start=start, max_iterations=min(steps, self.max_iterations), **shared)


_STEPS = 20  # of a refinement that is only to tell orders apart
_FAR = 1e-4  # share of the squared error by which the last step lowers it, of models without a group
_LOOSE = 1e-2  # the same, for an order that as many again would not bring back into question
_ASTRAY = (
    "the free-run fit ended at a pole of modulus {size:.6g}, and from the first samples of its own training data that "
    "model goes astray: {what}; expected data that a free run can follow: use focus='prediction', or another order"
)


def _told(model: StateSpaceModel, first: str, began: float, **found: Any) -> StateSpaceModel:
    """The model with what was chosen before its fit, and the time that all of it took."""
    info: Any = model.fit_info
    seconds = time.perf_counter() - began
    return replace(model, fit_info=replace(info, method=first + info.method, seconds=seconds, **found))
