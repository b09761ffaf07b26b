"""Signals that excite a vehicle or a model."""

from collections.abc import Callable

import numpy as np

from slipangle.data.signals import excitation
from slipangle.registry import Registry

SIGNALS: Registry[Callable[..., np.ndarray]] = Registry("signal", "slipangle.signals")
"""Signals by name: functions of ``n`` samples and, where one needs it, the sample time ``dt``; the rest by keyword."""

for _signal in (
    excitation.prbs,
    excitation.multisine,
    excitation.swept_sine,
    excitation.sine_with_dwell,
    excitation.step,
    excitation.ramp,
    excitation.staircase,
):
    SIGNALS.register(_signal.__name__.replace("_", "-"))(_signal)
