"""What training is made of: the `TrainingProblem`, its `Stage` after stage, and the precision of the arithmetic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol

from slipangle.fields import Checked, Count, NotNegative, Within

Precision = Literal["single", "double"]


@dataclass(frozen=True, kw_only=True)
class Stage(Checked):
    """One stage of training by Adam with a cosine decay of the learning rate.

    Parameters
    ----------
    horizon : int
        Steps that the loss looks ahead of the last measured output; 1 is one-step-ahead.
    epochs : int
        Longest duration. In an epoch every sample is predicted about once: at a horizon of 20 it has a twentieth of
        the windows.
    learning_rate : float
        At the start of the stage; it falls to a hundredth.
    batch : int
        Windows in one gradient step.
    patience : int
        Epochs without a smaller free-run error on the held-out part after which the stage ends.
    weight_decay : float
        Decoupled decay of the weights. [2]_

    References
    ----------
    .. [1] D. P. Kingma, J. Ba, Adam: a method for stochastic optimization, ICLR 2015.
    .. [2] I. Loshchilov, F. Hutter, Decoupled weight decay regularization, ICLR 2019.
    """

    horizon: Count = 1
    epochs: Count = 2000
    learning_rate: Annotated[float, Within(0, open="low", example="1e-3")] = 1e-3
    batch: Count = 100
    patience: Count = 1000
    weight_decay: NotNegative = 0.0


class TrainingProblem(Protocol):
    """What can be trained: hashable, equal when its functions are, so that they are compiled once.

    Parameters are any nest of tuples of arrays, in scaled coordinates. ``arrays`` is handed through to `loss`,
    `score` and `own`.
    """

    def loss(self, params: Any, arrays: Any, starts: Any, horizon: int) -> Any:
        """Mean squared error of windows of ``horizon`` steps that start at rows ``starts``. JAX function."""
        ...

    def score(self, params: Any, arrays: Any) -> Any:
        """Free-run error on the held-out part. JAX function."""
        ...

    def own(self, params: Any, arrays: Any) -> Any:
        """Free-run error on the training data. JAX function."""
        ...
