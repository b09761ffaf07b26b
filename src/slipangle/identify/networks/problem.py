"""What training is made of: the `Problem`, its `Stage` after stage, and the precision of the arithmetic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Protocol

from slipangle.errors import ParameterError

Precision = Literal["single", "double"]


@dataclass(frozen=True, kw_only=True)
class Stage:
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

    Raises
    ------
    ParameterError
        If a setting is out of range.

    References
    ----------
    .. [1] D. P. Kingma, J. Ba, Adam: a method for stochastic optimization, ICLR 2015.
    .. [2] I. Loshchilov, F. Hutter, Decoupled weight decay regularization, ICLR 2019.
    """

    horizon: int = 1
    epochs: int = 2000
    learning_rate: float = 1e-3
    batch: int = 100
    patience: int = 1000
    weight_decay: float = 0.0

    def __post_init__(self) -> None:
        for name in ("horizon", "epochs", "batch", "patience"):
            if getattr(self, name) < 1:
                raise ParameterError(f"{name} is {getattr(self, name)}; expected a whole number of at least 1")
        if not self.learning_rate > 0:
            raise ParameterError(f"learning_rate is {self.learning_rate}; expected a positive number, such as 1e-3")
        if not self.weight_decay >= 0:
            raise ParameterError(f"weight_decay is {self.weight_decay}; expected 0 or a small positive number")


class Problem(Protocol):
    """What can be trained: hashable, equal when its functions are, so that they are compiled once.

    Parameters are any nest of tuples of arrays, in scaled coordinates. ``arrays`` is handed through to `loss` and
    `score`.
    """

    def loss(self, params: Any, arrays: Any, starts: Any, horizon: int) -> Any:
        """Mean squared error of windows of ``horizon`` steps that start at rows ``starts``. JAX function."""
        ...

    def score(self, params: Any, arrays: Any) -> Any:
        """Free-run error on the held-out part. JAX function."""
        ...
