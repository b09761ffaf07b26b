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
    ``sa.Ode(f=...)`` takes equations of your own, ``sa.Delayed`` late inputs, ``sa.Collocation`` constraints, and
    ``sa.advise`` says what to drive; ``sa.validate(model, test)`` is the verdict; ``sa.save(model, "car.json")`` writes
    what ``sa.load`` opens.
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
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slipangle.control.followers.followers import PurePursuit, Stanley
    from slipangle.control.followers.preview_lqr import PreviewLQR
    from slipangle.control.marx.mpc import MultiARXMPC
    from slipangle.control.mpc import MPC
    from slipangle.control.speed.driver import SpeedDriver
    from slipangle.data.dataset import Channel, Dataset, join
    from slipangle.data.public.sets import public
    from slipangle.data.quality.inspect import inspect
    from slipangle.data.readers import read
    from slipangle.estimate.ekf import EKF
    from slipangle.identify.judge.compare import compare, cross_validate
    from slipangle.identify.judge.validate import Validation, validate
    from slipangle.identify.linear.arx import ARX
    from slipangle.identify.linear.polynomial import ARMAX, BoxJenkins, OutputError
    from slipangle.identify.linear.recursive import RLS
    from slipangle.identify.linear.statespace import StateSpace
    from slipangle.identify.lure.lure import Lure
    from slipangle.identify.networks.hybrid import Hybrid
    from slipangle.identify.networks.joint import Joint
    from slipangle.identify.networks.narx import NARX
    from slipangle.identify.networks.neural_statespace import NeuralStateSpace
    from slipangle.identify.physics.advise import advise
    from slipangle.identify.physics.collocation import Collocation
    from slipangle.identify.physics.grey_box import GreyBox
    from slipangle.models.black_box.arx import ARXModel
    from slipangle.models.black_box.narx import NARXModel
    from slipangle.models.custom import Ode
    from slipangle.models.model import FitInfo, Model, Trajectory
    from slipangle.models.storage import load, save
    from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
    from slipangle.models.tires.simple import LinearTire, MagicCurve, SimpleMagicFormula, Tire
    from slipangle.models.vehicles.bicycle import Bicycle
    from slipangle.models.vehicles.dual_track.dual_track import DualTrack
    from slipangle.models.vehicles.kinematic import Kinematic
    from slipangle.models.vehicles.longitudinal import Longitudinal, LongitudinalParams
    from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
    from slipangle.models.vehicles.parameters import BicycleParams, SingleTrackParams
    from slipangle.models.vehicles.single_track import SingleTrack
    from slipangle.models.wrappers.delayed import Delayed
    from slipangle.models.wrappers.multi_arx import MultiARXModel
    from slipangle.models.wrappers.on_ground import OnGround
    from slipangle.optimal.ipopt import Ipopt
    from slipangle.optimal.ocp import OCP, Reference
    from slipangle.optimal.realtime import RealTime
    from slipangle.optimal.terms import Limits, Values, Weights
    from slipangle.paths.lane_change import double_lane_change, lane_changes, obstacle_avoidance
    from slipangle.paths.path import Path
    from slipangle.report.comparison import comparison_page
    from slipangle.simulate.loop import closed_loop
    from slipangle.simulate.plant import Plant
    from slipangle.simulate.run import Run
    from slipangle.units import deg, kmh

_HOME = {  # where each public name lives; imported on first use, so that `import slipangle` is quick
    "slipangle.data.public.sets": ("public",),
    "slipangle.identify.networks.hybrid": ("Hybrid",),
    "slipangle.identify.networks.joint": ("Joint",),
    "slipangle.identify.lure.lure": ("Lure",),
    "slipangle.optimal.realtime": ("RealTime",),
    "slipangle.optimal.ipopt": ("Ipopt",),
    "slipangle.optimal.ocp": ("OCP", "Reference"),
    "slipangle.models.vehicles.dual_track.dual_track": ("DualTrack",),
    "slipangle.control.followers.followers": ("PurePursuit", "Stanley"),
    "slipangle.control.followers.preview_lqr": ("PreviewLQR",),
    "slipangle.data.dataset": ("Channel", "Dataset", "join"),
    "slipangle.data.readers": ("read",),
    "slipangle.data.quality.inspect": ("inspect",),
    "slipangle.paths.path": ("Path",),
    "slipangle.paths.lane_change": ("double_lane_change", "lane_changes", "obstacle_avoidance"),
    "slipangle.models.model": ("FitInfo", "Model", "Trajectory"),
    "slipangle.models.tires.simple": ("LinearTire", "MagicCurve", "SimpleMagicFormula", "Tire"),
    "slipangle.models.vehicles.bicycle": ("Bicycle",),
    "slipangle.models.vehicles.kinematic": ("Kinematic",),
    "slipangle.models.vehicles.longitudinal": ("Longitudinal", "LongitudinalParams"),
    "slipangle.models.vehicles.parameters": ("BicycleParams", "SingleTrackParams"),
    "slipangle.models.vehicles.single_track": ("SingleTrack",),
    "slipangle.models.black_box.arx": ("ARXModel",),
    "slipangle.models.black_box.narx": ("NARXModel",),
    "slipangle.models.tires.magic_formula.tire": ("MagicFormulaTire",),
    "slipangle.models.vehicles.nonlinear_bicycle": ("NonlinearBicycle", "NonlinearBicycleParams"),
    "slipangle.models.storage": ("load", "save"),
    "slipangle.models.wrappers.on_ground": ("OnGround",),
    "slipangle.models.wrappers.multi_arx": ("MultiARXModel",),
    "slipangle.models.custom": ("Ode",),
    "slipangle.models.wrappers.delayed": ("Delayed",),
    "slipangle.identify.linear.arx": ("ARX",),
    "slipangle.identify.networks.narx": ("NARX",),
    "slipangle.identify.physics.grey_box": ("GreyBox",),
    "slipangle.identify.physics.collocation": ("Collocation",),
    "slipangle.identify.physics.advise": ("advise",),
    "slipangle.identify.judge.compare": ("compare", "cross_validate"),
    "slipangle.estimate.ekf": ("EKF",),
    "slipangle.identify.networks.neural_statespace": ("NeuralStateSpace",),
    "slipangle.identify.linear.polynomial": ("ARMAX", "BoxJenkins", "OutputError"),
    "slipangle.identify.linear.recursive": ("RLS",),
    "slipangle.identify.linear.statespace": ("StateSpace",),
    "slipangle.identify.judge.validate": ("Validation", "validate"),
    "slipangle.control.speed.driver": ("SpeedDriver",),
    "slipangle.control.mpc": ("MPC",),
    "slipangle.control.marx.mpc": ("MultiARXMPC",),
    "slipangle.optimal.terms": ("Limits", "Values", "Weights"),
    "slipangle.report.comparison": ("comparison_page",),
    "slipangle.simulate.loop": ("closed_loop",),
    "slipangle.simulate.plant": ("Plant",),
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
    "OCP",
    "RLS",
    "ARXModel",
    "Bicycle",
    "BicycleParams",
    "BoxJenkins",
    "Channel",
    "Collocation",
    "Dataset",
    "Delayed",
    "DualTrack",
    "FitInfo",
    "GreyBox",
    "Hybrid",
    "Ipopt",
    "Joint",
    "Kinematic",
    "Limits",
    "LinearTire",
    "Longitudinal",
    "LongitudinalParams",
    "Lure",
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
    "PreviewLQR",
    "PurePursuit",
    "RealTime",
    "Reference",
    "Run",
    "SimpleMagicFormula",
    "SingleTrack",
    "SingleTrackParams",
    "SpeedDriver",
    "Stanley",
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
    "public",
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
