"""Estimators of the job's models that are not physics, from their settings."""

from __future__ import annotations

from slipangle.identify.judge.compare import Estimator
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.polynomial import ARMAX, BoxJenkins, OutputError
from slipangle.identify.linear.statespace import StateSpace
from slipangle.workflow.settings import ModelSettings

BLACK_BOXES = ("arx", "armax", "output-error", "box-jenkins", "state-space", "narx")


def estimator(wanted: ModelSettings) -> Estimator:
    """The estimator of a black-box model.

    Parameters
    ----------
    wanted : ModelSettings
        Its kind is one of `BLACK_BOXES`.
    """
    s = wanted
    if s.kind == "arx":
        return ARX(na=s.na, nb=s.nb, nk=s.nk, offset=s.offset)
    if s.kind == "armax":
        return ARMAX(na=s.na, nb=s.nb, nc=s.nc, nk=s.nk, offset=s.offset)
    if s.kind == "output-error":
        return OutputError(nb=s.nb, nf=s.nf, nk=s.nk, offset=s.offset, max_radius=1.0)
    if s.kind == "box-jenkins":
        return BoxJenkins(nb=s.nb, nf=s.nf, nc=s.nc, nd=s.nd, nk=s.nk, offset=s.offset)
    if s.kind == "state-space":
        order = s.order[0] if len(s.order) == 1 else s.order or StateSpace.order
        offsets = "output" if s.offset else "none"
        return StateSpace(order=order, focus=s.focus, offsets=offsets, direct=s.nk == 0, max_radius=1.0)
    from slipangle.identify.networks.narx import NARX  # brings JAX

    return NARX(na=s.na, nb=s.nb, nk=s.nk, hidden=s.hidden, seeds=s.seeds)
