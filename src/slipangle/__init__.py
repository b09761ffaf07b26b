"""slipangle: from a vehicle's drive log to an identified model to a predictive controller.

The tree is the workflow, and so are the names here:

>>> import slipangle as sa

log -> data
    ``data = sa.read("run.csv", inputs=["delta", "v_x"], outputs=["r"])``, or ``sa.load("ferrari-250lm")``;
    ``sa.inspect(data)`` says what is wrong with it; ``train, test = data.split(0.7)``.
data -> models
    ``sa.Bicycle``, ``sa.SingleTrack``, ``sa.Longitudinal``, ``sa.Kinematic``, ``sa.ARXModel``, with tires
    ``sa.LinearTire`` and ``sa.SimpleMagicFormula``. Each is a ``sa.Model``: ``step``, ``output``, ``simulate``,
    ``predict``.
models -> identify
    ``sa.GreyBox(start=bicycle, free=("C_f", "C_r", "inertia_z")).fit(train)``, ``sa.ARX(na=2, nb=2).fit(train)``;
    ``sa.Ode(f=...)`` takes equations of your own, ``sa.Delayed`` late inputs, ``sa.Collocation`` constraints, and
    ``sa.advise`` says what to drive; ``sa.validate(model, test)`` is the verdict.
identify -> control
    ``sa.MPC(sa.OnGround(model), horizon=20, Q=sa.Weights(Y=1.0), S=sa.Weights(delta=50.0), ...)``.
control -> simulate
    ``sa.closed_loop(plant, mpc, sa.double_lane_change(20.0))`` returns a ``sa.Run``.
simulate -> report
    ``slipangle.report`` has the figures and the page; ``slipangle run job.toml`` does all of this at once.

Inside, everything is SI and radians, axes are those of ISO 8855 (docs/nomenclature.md).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slipangle.control.driver import SpeedDriver
    from slipangle.control.mpc import MPC
    from slipangle.control.multi_arx import MultiARXMPC
    from slipangle.control.terms import Limits, Values, Weights
    from slipangle.data.dataset import Channel, Dataset, join
    from slipangle.data.manoeuvres import double_lane_change, lane_changes, obstacle_avoidance
    from slipangle.data.path import Path
    from slipangle.data.public import load
    from slipangle.data.quality import inspect
    from slipangle.data.readers import read
    from slipangle.identify.advice import advise
    from slipangle.identify.arx import ARX
    from slipangle.identify.collocation import Collocation
    from slipangle.identify.compare import compare, cross_validate
    from slipangle.identify.greybox import GreyBox
    from slipangle.identify.kalman import EKF
    from slipangle.identify.narx import NARX
    from slipangle.identify.neural_statespace import NeuralStateSpace
    from slipangle.identify.polynomial import ARMAX, BoxJenkins, OutputError
    from slipangle.identify.recursive import RLS
    from slipangle.identify.statespace import StateSpace
    from slipangle.identify.validate import Validation, validate
    from slipangle.models.arx import ARXModel
    from slipangle.models.custom import Ode
    from slipangle.models.delayed import Delayed
    from slipangle.models.ground import OnGround
    from slipangle.models.magic_formula import MagicFormulaTire
    from slipangle.models.model import FitInfo, Model, Trajectory
    from slipangle.models.multi_arx import MultiARXModel
    from slipangle.models.narx import NARXModel
    from slipangle.models.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
    from slipangle.models.storage import save
    from slipangle.models.tires import LinearTire, MagicCurve, SimpleMagicFormula, Tire
    from slipangle.models.vehicles import (
        Bicycle,
        BicycleParams,
        Kinematic,
        Longitudinal,
        LongitudinalParams,
        SingleTrack,
        SingleTrackParams,
    )
    from slipangle.report.comparison import comparison_page
    from slipangle.simulate.loop import closed_loop
    from slipangle.simulate.plants import Plant
    from slipangle.simulate.run import Run
    from slipangle.units import deg, kmh

_HOME = {  # where each public name lives; imported on first use, so that `import slipangle` is quick
    "slipangle.data.dataset": ("Channel", "Dataset", "join"),
    "slipangle.data.readers": ("read",),
    "slipangle.data.public": ("load",),
    "slipangle.data.quality": ("inspect",),
    "slipangle.data.path": ("Path",),
    "slipangle.data.manoeuvres": ("double_lane_change", "lane_changes", "obstacle_avoidance"),
    "slipangle.models.model": ("FitInfo", "Model", "Trajectory"),
    "slipangle.models.tires": ("LinearTire", "MagicCurve", "SimpleMagicFormula", "Tire"),
    "slipangle.models.vehicles": (
        "Bicycle",
        "BicycleParams",
        "Kinematic",
        "Longitudinal",
        "LongitudinalParams",
        "SingleTrack",
        "SingleTrackParams",
    ),
    "slipangle.models.arx": ("ARXModel",),
    "slipangle.models.narx": ("NARXModel",),
    "slipangle.models.magic_formula": ("MagicFormulaTire",),
    "slipangle.models.nonlinear_bicycle": ("NonlinearBicycle", "NonlinearBicycleParams"),
    "slipangle.models.storage": ("save",),
    "slipangle.models.ground": ("OnGround",),
    "slipangle.models.multi_arx": ("MultiARXModel",),
    "slipangle.models.custom": ("Ode",),
    "slipangle.models.delayed": ("Delayed",),
    "slipangle.identify.arx": ("ARX",),
    "slipangle.identify.narx": ("NARX",),
    "slipangle.identify.greybox": ("GreyBox",),
    "slipangle.identify.collocation": ("Collocation",),
    "slipangle.identify.advice": ("advise",),
    "slipangle.identify.compare": ("compare", "cross_validate"),
    "slipangle.identify.kalman": ("EKF",),
    "slipangle.identify.neural_statespace": ("NeuralStateSpace",),
    "slipangle.identify.polynomial": ("ARMAX", "BoxJenkins", "OutputError"),
    "slipangle.identify.recursive": ("RLS",),
    "slipangle.identify.statespace": ("StateSpace",),
    "slipangle.identify.validate": ("Validation", "validate"),
    "slipangle.control.driver": ("SpeedDriver",),
    "slipangle.control.mpc": ("MPC",),
    "slipangle.control.multi_arx": ("MultiARXMPC",),
    "slipangle.control.terms": ("Limits", "Values", "Weights"),
    "slipangle.report.comparison": ("comparison_page",),
    "slipangle.simulate.loop": ("closed_loop",),
    "slipangle.simulate.plants": ("Plant",),
    "slipangle.simulate.run": ("Run",),
    "slipangle.units": ("deg", "kmh"),
}
_MODULE = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "ARMAX",
    "ARX",
    "EKF",
    "MPC",
    "NARX",
    "RLS",
    "ARXModel",
    "Bicycle",
    "BicycleParams",
    "BoxJenkins",
    "Channel",
    "Collocation",
    "Dataset",
    "Delayed",
    "FitInfo",
    "GreyBox",
    "Kinematic",
    "Limits",
    "LinearTire",
    "Longitudinal",
    "LongitudinalParams",
    "MagicCurve",
    "MagicFormulaTire",
    "Model",
    "MultiARXMPC",
    "MultiARXModel",
    "NARXModel",
    "NeuralStateSpace",
    "NonlinearBicycle",
    "NonlinearBicycleParams",
    "Ode",
    "OnGround",
    "OutputError",
    "Path",
    "Plant",
    "Run",
    "SimpleMagicFormula",
    "SingleTrack",
    "SingleTrackParams",
    "SpeedDriver",
    "StateSpace",
    "Tire",
    "Trajectory",
    "Validation",
    "Values",
    "Weights",
    "advise",
    "closed_loop",
    "compare",
    "comparison_page",
    "cross_validate",
    "deg",
    "double_lane_change",
    "inspect",
    "join",
    "kmh",
    "lane_changes",
    "load",
    "obstacle_avoidance",
    "read",
    "save",
    "validate",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        raise AttributeError(f"module 'slipangle' has no attribute {name!r}")
    return getattr(import_module(_MODULE[name]), name)


def __dir__() -> list[str]:
    return __all__
