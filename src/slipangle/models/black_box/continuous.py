"""Linear systems that were fitted in continuous time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from slipangle.errors import ParameterError
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.model import derived
from slipangle.numerics.held import late


@dataclass(frozen=True, kw_only=True)
class ContinuousTimeModel(StateSpaceModel):
    """``x' = F x + G u(t - delay)``, ``y = H x + y_0``: a state space whose samples are exactly those of this system.

    The input is held over each sample; those that are still on their way are the last states. Made by `of`.

    Parameters
    ----------
    F, G, H : array, shapes (n, n), (n,), (n,)
        Of the system in continuous time, one input to one output.
    delay : float
        By which the input acts late. [s]
    slopes : array, shape (n_estimates, n * n + 2 * n + 1)
        Derivatives of the entries of F, G, H and the delay by the estimates of the fit; empty where there is none.

    Source: L. Ljung, System Identification, 2nd ed., 1999, sec. 4.3.
    """

    F: np.ndarray
    G: np.ndarray
    H: np.ndarray
    delay: float
    slopes: np.ndarray

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.inputs) != 1 or len(self.outputs) != 1:
            raise ParameterError(
                f"{len(self.inputs)} inputs and {len(self.outputs)} outputs; expected one of each of a system that was "
                "fitted in continuous time: make one model per output"
            )
        n = len(np.atleast_2d(self.F))
        shapes = {"F": (n, n), "G": (n,), "H": (n,), "slopes": (len(self.slopes), n * n + 2 * n + 1)}
        self._freeze(shapes, f"{n} states")

    @classmethod
    def of(
        cls,
        F: np.ndarray,
        G: np.ndarray,
        H: np.ndarray,
        *,
        delay: float,
        dt: float,
        slopes: np.ndarray | None = None,
        **others: Any,
    ) -> Self:
        """The model of such a system at a sample time [s]; ``others`` are fields of `StateSpaceModel`."""
        n = len(F)
        one = late(F, G, delay, dt)
        kept = one.whole + bool(np.abs(one.older).max() > 0)
        A, B = np.zeros((n + kept, n + kept)), np.zeros((n + kept, 1))
        A[:n, :n] = one.A
        for column, back in ((one.older, one.whole + 1), (one.newer, one.whole)):
            if back == 0:
                B[:n, 0] += column
            elif back <= kept:
                A[:n, n + back - 1] += column
        if kept:
            B[n, 0] = 1.0
            A[n + 1 :, n : n + kept - 1] += np.eye(kept - 1)
        C = np.concatenate([H, np.zeros(kept)])[None]
        told = np.zeros((0, n * n + 2 * n + 1)) if slopes is None else slopes
        return cls(A=A, B=B, C=C, F=F, G=G, H=H, delay=delay, dt=dt, slopes=told, **others)

    continuous = derived(lambda self: (self.F, self.G, self.H, self.delay))

    def with_estimates(self, values: np.ndarray) -> Self | None:
        """The system that other estimates give, to first order; None without a fit."""
        info, n = self.fit_info, len(self.F)
        if info is None or len(self.slopes) != len(info.values):
            return None
        move = (np.asarray(values) - info.values) @ self.slopes
        F, G, H = (v + d for v, d in zip((self.F.ravel(), self.G, self.H), np.split(move[:-1], [n * n, n * n + n]),
                                         strict=True))  # fmt: skip
        late_by = max(self.delay + float(move[-1]), 0.0)
        own: dict[str, Any] = {"dt": self.dt, "inputs": self.inputs, "outputs": self.outputs}
        own |= {"u_offset": self.u_offset, "y_offset": self.y_offset, "slopes": self.slopes}
        return type(self).of(
            F.reshape(n, n), G, H, delay=late_by, fit_info=replace(info, values=np.array(values)), **own
        )
