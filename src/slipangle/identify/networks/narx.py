"""NARX networks by Adam: one-step-ahead first, then several steps ahead, judged by free runs."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import IdentifiabilityWarning, ModelWarning, SimulationError, SlipangleError
from slipangle.fields import Count
from slipangle.identify.excitation import require_independent
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.estimator import channels
from slipangle.identify.linear.lags import same_for_all
from slipangle.identify.linear.orders import Chosen, choose
from slipangle.identify.linear.polynomial import OutputError
from slipangle.identify.networks.estimator import Again, NetworkEstimator, Settled
from slipangle.identify.networks.lag_form import ALIKE, lag_forms, longest, state_space
from slipangle.identify.networks.problem import Stage
from slipangle.identify.networks.windows import Recurrence, beside, forward, from_linear, layers, network
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.black_box.networks import MLP, Activation, Scaling
from slipangle.models.model import derived
from slipangle.models.plausible import growth

STAGES = (Stage(horizon=1, epochs=1000), Stage(horizon=20, epochs=2000))


@dataclass(frozen=True, kw_only=True)
class NARX(NetworkEstimator[NARXModel]):
    """NARX estimator with a multilayer perceptron.

    Parameters
    ----------
    na, nb : int or "chosen"
        Past outputs and past inputs used, at least 1.
    nk : int or "chosen", optional
        Samples from input to output, at least 1; 1 where the lags are given. Orders that are not given are those of the
        ARX model whose free runs over stretches held out in turn are best, see `slipangle.identify.linear.arx.ARX`, of
        what is not held out here; one network is trained. ``fit_info.candidates`` are all that were compared.
    hidden, activation, stages, holdout, seeds, linear_start, precision
        See `NetworkEstimator`; by default the loss looks one step ahead, then 20. The linear start is the ARX model of
        these lags or, of one input and one output, the output-error model, whichever runs freely better over the
        held-out part. Where all orders are open and the linear state space runs better there than both, it is the
        start, as a difference equation, and the orders are those of that.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, sec. 4.2.
    """

    na: Count | Chosen = "chosen"
    nb: Count | Chosen = "chosen"
    hidden: tuple[Count, ...] = (50, 50, 50)
    activation: Activation = "elu"
    nk: Count | Chosen | None = None
    stages: tuple[Stage, ...] = STAGES

    _what = "a NARX network"

    def __post_init__(self) -> None:
        same_for_all(self, "nb", "nk")
        if self.nk is None:
            object.__setattr__(self, "nk", "chosen" if "chosen" in (self.na, self.nb) else 1)
        super().__post_init__()

    _memory = derived(lambda self: max(self.na, self.nb + self.nk - 1))

    def settled(self, data: Dataset) -> tuple[Self, Settled]:
        """These settings with every order a number, and how they were chosen."""
        given: Any = {"na": self.na, "nb": self.nb, "nk": self.nk}
        if "chosen" not in given.values():
            return self, Settled()
        inner = data if self.holdout == 0 else data.split(1 - self.holdout)[0]
        require_independent(inner)
        choice = choose(inner, offset=True, same=True, **given)
        best = choice.ranked[0][0]
        said = f"{choice.said(best)}, as an ARX model"
        chosen = replace(self, na=best.na, nb=best.nb[0], nk=best.nk[0])
        if not self.linear_start or set(given.values()) != {"chosen"}:
            return chosen, Settled(said, choice.candidates)
        linear = chosen._better_linear(*chosen.cut(data))
        if linear is None:
            return chosen, Settled(said, choice.candidates)
        lags: Any = {"na": linear.na, "nb": linear.nb, "nk": linear.nk}
        told = ", ".join(f"{name} = {n}" for name, n in lags.items())
        said = f"{told}, of a linear state space that ran freely better than models of {said}"
        return replace(self, **lags), Settled(said, choice.candidates, linear)

    def _better_linear(self, data: Dataset, held: Dataset) -> ARXModel | None:
        """The linear state space by lags, where it runs freely better than the linear models of these lags do."""
        found = state_space(data)
        forms = [] if found is None else lag_forms(*found)
        errors = [free_run_error(m, held) for m in forms]
        at = longest(forms, errors)
        if at is None:
            return None
        with warnings.catch_warnings():
            for kind in (ModelWarning, IdentifiabilityWarning):  # of models that are only compared
                warnings.simplefilter("ignore", kind)
            others = [free_run_error(m, held) for m in self._models(data)]
        return forms[at] if errors[at] < min(others, default=np.inf) else None

    @property
    def _lags(self) -> Any:
        """``na``, ``nb`` and ``nk``, once they are numbers."""
        return {"na": self.na, "nb": self.nb, "nk": self.nk}

    def _n_seen(self, ny: int, nu: int) -> int:
        return self._lags["na"] * ny + self._lags["nb"] * nu

    def _problem(self) -> LagNetwork:
        return LagNetwork(**self._lags, activation=self.activation)

    def _linear(self, data: Dataset, held: Dataset, *known: ARXModel) -> tuple[np.ndarray, np.ndarray]:
        """Slope by the lags and constant: ARX, output error of one input and output, or a known one.

        The one that runs best; of others that are about as good, the known one, as chance tells which is best.
        """
        found = [*known, *self._models(data)]
        if not found:
            raise SimulationError(growth(ARX(**self._lags, offset=True).fit(data).poles, data.n_longest))
        errors = np.array([free_run_error(m, held) for m in found])
        errors[: len(known)] /= ALIKE
        best = found[int(np.argmin(errors))]
        return np.hstack([*(-best.A), *best.B]), best.c

    def _models(self, data: Dataset) -> list[ARXModel]:
        """Linear models of these lags that do not blow up."""
        model = ARX(**self._lags, offset=True).fit(data)
        found = [] if growth(model.poles, data.n_longest) else [model]
        return found + (self._output_error(data) if len(data.inputs) == len(data.outputs) == 1 else [])

    def _output_error(self, data: Dataset) -> list[ARXModel]:
        """The output-error model as a difference equation of the same lags, where there is one."""
        lags = self._lags
        settings = OutputError(nb=lags["nb"], nf=lags["na"], nk=lags["nk"], offset=True, max_radius=1.0)
        try:
            model = settings.fit(data)
        except SlipangleError:
            return []
        B, F = np.asarray(model.B[0]), np.asarray(model.F[0])
        rest: Any = model.u_offset
        c = np.array([model.y_offset * (1 + F.sum()) - B.sum() * rest[0]])
        return [ARXModel(A=F, B=B, c=c, nk=lags["nk"], **channels(data))]

    def _initial(self, seed: int, ny: int, nu: int, linear: Any) -> tuple:
        net = MLP.random((self._n_seen(ny, nu), *self.hidden, ny), activation=self.activation, seed=seed)
        return layers(from_linear(net, *linear) if linear else net)

    def _model(self, params: Any, scaling_u: Scaling, scaling_y: Scaling, again: Again, channels: Any) -> NARXModel:
        lags = beside(*[scaling_y] * self._lags["na"], *[scaling_u] * self._lags["nb"])
        net = network(params, self.activation, lags, scaling_y)
        return NARXModel(network=net, **self._lags, **channels)


@dataclass(frozen=True)
class LagNetwork(Recurrence):
    """Loss and free-run score of a network of lags; the state is the past outputs, newest first."""

    na: int
    nb: int
    nk: int
    activation: Activation

    memory = derived(lambda self: max(self.na, self.nb + self.nk - 1))

    def start(self, params: Any, u: Any, y: Any) -> Any:
        """Measured past outputs."""
        import jax.numpy as jnp

        return jnp.concatenate([y(-i) for i in range(1, self.na + 1)])

    def advance(self, params: Any, x: Any, u: Any, y: Any, k: Any) -> tuple[Any, Any]:
        """Predicted outputs in front, lags shifted by one; their errors."""
        import jax.numpy as jnp

        drive = jnp.concatenate([u(k - j) for j in range(self.nk, self.nk + self.nb)])
        predicted = forward(params, jnp.concatenate([x, drive]), self.activation)
        return jnp.concatenate([predicted, x])[: len(x)], predicted - y(k)


def free_run_error(model: ARXModel, data: Dataset) -> float:
    """Mean squared error of a free run; infinite where it is no number."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            run = model._simulate(data)
            error = float(np.mean(run.error[run.predicted] ** 2))
    except SlipangleError:
        return np.inf
    return error if np.isfinite(error) else np.inf
