"""The Ferrari of chapter 8: the nonlinear bicycle and physics with a network as in table 8.2, a hybrid at less cost."""

from __future__ import annotations

from dataclasses import replace

from slipangle.identify.networks.hybrid import Hybrid
from slipangle.identify.networks.problem import Stage
from slipangle.models.model import Model
from slipangle.reproduce import _chapter_8, table_8_2
from tests.machines.fits_black_box import free_run
from tests.machines.registry import Errors, fit


def judged(model: Model) -> Errors:
    """Errors on both parts and the fit of table 8.2. [%]"""
    train, test = _chapter_8.ferrari()
    return {**free_run(model, train, test), "fit": _chapter_8.judge(model, test).free.fit}


@fit("nonlinear bicycle, Ferrari, table 8.2", least={"fit": 90.5})
def _() -> Errors:
    return judged(_chapter_8.nonlinear_bicycle(_chapter_8.ferrari()[0]))


@fit("physics with a network, Ferrari, table 8.2, seed 0")
def _() -> Errors:
    train, _ = _chapter_8.ferrari()
    settings = _chapter_8.joint(_chapter_8.nonlinear_bicycle(train), (0,))
    return judged(settings.fit(train))


@fit("M3-H, Ferrari, 200 epochs")
def _() -> Errors:
    train, _ = _chapter_8.ferrari()
    base = table_8_2.state_space(train, _chapter_8.PRODUCT)
    stages = (Stage(horizon=1, epochs=100), Stage(horizon=40, epochs=100, learning_rate=3e-3))
    network = replace(_chapter_8.narx(0, stages), hidden=(20,))
    return judged(Hybrid(base=base, discrepancy=network, inputs=table_8_2.SEEN).fit(train))
