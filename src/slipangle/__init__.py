"""slipangle: from a vehicle's drive log to an identified model to a predictive controller.

The tree is the workflow, and so are the names here:

>>> import slipangle as sa

log -> data
    ``data = sa.read("run.csv", inputs=["delta", "v_x"], outputs=["r"])``, or ``sa.public("ferrari-250lm")``;
    ``sa.inspect(data)`` says what is wrong with it; ``train, test = data.split(0.7)``.
data -> models
    ``sa.Bicycle``, ``sa.SingleTrack``, ``sa.Longitudinal``, ``sa.Kinematic``, ``sa.ARXModel``, with tires
    ``sa.LinearTire`` and ``sa.SimpleMagicFormula``. Each is a ``sa.Model``: ``step``, ``output``, ``simulate``,
    ``predict``.
models -> identify
    ``sa.GreyBox(start=bicycle, free=("C_f", "C_r", "inertia_z")).fit(train)``, ``sa.ARX(na=2, nb=2).fit(train)``;
    ``sa.Ode(f=...)`` takes equations of your own, ``sa.LookupTable`` curves in them, ``sa.Delayed`` late inputs,
    ``sa.Collocation`` constraints, and ``sa.advise`` says what to drive; ``sa.validate(model, test)`` is the verdict;
    ``sa.save(model, "car.json")`` writes what ``sa.load`` opens.
identify -> control
    ``sa.MPC(sa.OnGround(model), horizon=20, Q=sa.Weights(Y=1.0), S=sa.Weights(delta=50.0), ...)``, solved by
    ``sa.RealTime`` or, as the reference, ``sa.Ipopt``; ``sa.Stanley`` and others to compare with.
control -> simulate
    ``sa.closed_loop(plant, mpc, sa.double_lane_change(20.0))`` returns a ``sa.Run``.
simulate -> report
    ``slipangle.report`` has the figures and the page; ``slipangle run job.toml`` does all of this at once.

Inside, everything is SI and radians, axes are those of ISO 8855 (docs/nomenclature.md).
"""

from importlib import import_module
from pathlib import Path as _File
from typing import Any

_STUB = _File(__file__).with_name(
    "__init__.pyi"
)  # where each name lives, one import a line, which type checkers read too
_LINES = [line.split() for line in _STUB.read_text(encoding="utf-8").splitlines() if line.startswith("from ")]
_MODULE = {name: module for _, module, _, name, *_ in _LINES}  # imported on first use: `import slipangle` is quick
__all__ = sorted(_MODULE)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        raise AttributeError(f"module 'slipangle' has no attribute {name!r}")
    return getattr(import_module(_MODULE[name]), name)


def __dir__() -> list[str]:
    return __all__
