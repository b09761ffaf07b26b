"""One instance of every model class, for tests that hold for all of them."""

from dataclasses import replace

import numpy as np

from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.continuous import ContinuousTimeModel
from slipangle.models.black_box.lure import LureModel
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.black_box.networks import MLP, Scaling
from slipangle.models.black_box.neural_statespace import NeuralStateSpaceModel
from slipangle.models.black_box.polynomial import PolynomialModel
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.custom import Ode
from slipangle.models.tires.neural import NeuralCurve, NeuralTire
from slipangle.models.tires.simple import LinearTire
from slipangle.models.vehicles.aided import RearSteered, TorqueVectored
from slipangle.models.vehicles.banked import Banked
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import (
    BMW_320I,
    FERRARI_250LM,
    PASSENGER_TIRE,
    SOUSA_CAR_7,
    SOUSA_TABLE_6_1,
    SOUSA_TABLE_6_2,
    SOUSA_TABLE_6_8,
    SOUSA_TABLE_6_10,
    SOUSA_TABLE_7_2,
)
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.kinematic import Kinematic
from slipangle.models.vehicles.load_transfer import LoadTransfer
from slipangle.models.vehicles.longitudinal import DrivelineParams, Longitudinal, LongitudinalParams, PedalCar
from slipangle.models.vehicles.neural_bicycle import NeuralBicycle, TireNetworkBicycle
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
from slipangle.models.vehicles.quasi_steady import QuasiSteadySingleTrack
from slipangle.models.vehicles.saturating_bicycle import (
    RelaxingBicycle,
    SaturatingBicycle,
    SaturatingBicycleParams,
)
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.models.vehicles.steering import Steered
from slipangle.models.vehicles.tire_bicycle import TireBicycle, TireBicycleParams
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.disturbed import Disturbed
from slipangle.models.wrappers.ensemble import EnsembleModel
from slipangle.models.wrappers.hybrid import HybridModel, OffsetModel
from slipangle.models.wrappers.lagging import Lagging
from slipangle.models.wrappers.multi_arx import MultiARXModel, ParallelARX
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.ops import tanh, where
from slipangle.reproduce.plants.emps import Emps, EmpsParams, FrictionCurve
from slipangle.reproduce.plants.pendulum import Pendulum
from slipangle.units import SI

LIMIT = NonlinearBicycleParams(
    mass=982.0, inertia_z=900.0, wheelbase=2.4, l_f=1.3, C_f=6e4, C_r=9e4, bias_r=0.01, compliance=1e-6
)
AXLES = SaturatingBicycleParams(
    **dict(mass=982.0, inertia_z=900.0, wheelbase=2.4, l_f=1.3, C_f=6e4, C_r=9e4, mu_f=1.1, mu_r=1.3),
    **dict(bias_r=0.01, bias_v_y=-0.05, bias_a_y=0.1, lever_v_y=0.2, relaxation_f=0.3, relaxation_r=0.4),
    **dict(downforce_f=0.7, downforce_r=1.1, gain_v_y=1.15, turn_v_y=0.02),
)
LINEAR = LinearTire(C_alpha=6e4, C_s=1e5)
DALLARA = LongitudinalParams(mass=790.0, k_e=6000.0, k_d=60.0, k_r=0.02)


def discrepancy(inputs, outputs, seed=4):
    n = 2 * len(outputs) + 3 * len(inputs)
    return NARXModel(
        network=MLP.random((n, 8, len(outputs)), activation="tanh", seed=seed, output_scaling=small(len(outputs))),
        na=2,
        nb=3,
        dt=0.05,
        inputs=inputs,
        outputs=outputs,
    )


def small(n):
    return Scaling(offset=[0.0] * n, factor=[0.05] * n)


def neural_tire(**settings):
    """Friction of one hyperbolic tangent, near table 6.2's."""
    curves = {
        name: NeuralCurve(
            network=MLP(
                weights=([[slope * reach]], [[peak]]),
                biases=([0.0], [0.0]),
                activation="tanh",
                input_scaling=Scaling.between([-reach], [reach]),
            )
        )
        for name, slope, peak, reach in (("longitudinal", 20.0, 1.0, 1.0), ("lateral", 9.0, 0.9, 1.7))
    }
    return NeuralTire(**curves, **settings)


def neural_bicycle(seed, outputs=("r",), kind=NeuralBicycle, **fields):
    sizes = Scaling(offset=[0.0, 0.0, 0.0, 0.0, 25.0, 0.0], factor=[1.0, 0.4, 0.05, 0.05, 15.0, 4.0])
    n, _ = kind.network_outputs
    network = MLP.random((6, 7, n), activation="tanh", seed=seed, input_scaling=sizes, output_scaling=small(n))
    return kind(params=LIMIT, network=network, dt=0.05, outputs=outputs, **fields)


def spring(x, u, p):
    """Mass on a spring with friction and a stop."""
    friction = p.friction * tanh(x[1] / 0.1) + where(x[0] > 1.0, 50.0 * (x[0] - 1.0), 0.0)
    return [x[1], (u[0] - p.stiffness * x[0] - friction) / p.mass]


ALL_MODELS = {
    "bicycle": Bicycle(params=FERRARI_250LM, dt=0.05),
    "bicycle, three outputs": Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("v_y", "r", "a_y")),
    "bicycle, euler": Bicycle(params=SOUSA_TABLE_7_2, dt=0.01, method="euler"),
    "nonlinear bicycle": NonlinearBicycle(params=LIMIT, dt=0.05, outputs=("r", "v_y", "a_y")),
    "saturating bicycle": SaturatingBicycle(params=AXLES, dt=0.02, outputs=("v_y", "r", "a_y")),
    "relaxing bicycle": RelaxingBicycle(params=AXLES, dt=0.02, outputs=("a_y", "r")),
    "bicycle on tires": TireBicycle(
        params=TireBicycleParams(mass=1500.0, inertia_z=2500.0, wheelbase=2.7, l_f=1.2, transfer_f=0.2, LKY_r=1.1),
        dt=0.02,
        tire_f=PASSENGER_TIRE,
        tire_r=PASSENGER_TIRE,
        outputs=("v_y", "r", "a_y"),
    ),
    "steered bicycle": Steered(Bicycle(params=FERRARI_250LM, dt=0.02), steering_lag=0.05),
    "rear-steered bicycle": RearSteered(Bicycle(params=FERRARI_250LM, dt=0.02, outputs=("a_y", "r"))),
    "torque-vectored bicycle": TorqueVectored(Bicycle(params=FERRARI_250LM, dt=0.02, outputs=("a_y", "r"))),
    "torque-vectored, banked": Banked(TorqueVectored(SaturatingBicycle(params=AXLES, dt=0.02), gain_M_z=0.9)),
    "with load transfer": LoadTransfer(
        RelaxingBicycle(params=AXLES, dt=0.02, outputs=("r", "a_y")), height=0.5, load_lag=0.06
    ),
    "steered, with load transfer": Steered(
        LoadTransfer(Banked(SaturatingBicycle(params=AXLES, dt=0.02)), height=0.4, drive_rear=0.3), steering_lag=0.05
    ),
    "banked bicycle": Banked(Bicycle(params=FERRARI_250LM, dt=0.02, outputs=("a_y", "r"))),
    "steered, banked": Steered(Banked(SaturatingBicycle(params=AXLES, dt=0.02)), steering_lag=0.05),
    "steered, rate limit, delayed": Delayed(
        Steered(SaturatingBicycle(params=AXLES, dt=0.02), steering_lag=0.05, steering_rate=0.5),
        delays={"delta": 0.03},
        longest=0.1,
    ),
    "kinematic": Kinematic(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("X", "Y", "psi", "r")),
    "longitudinal": Longitudinal(params=DALLARA, dt=0.04),
    "pedal car": PedalCar(
        params=DrivelineParams(mass=790.0, k_e=6000.0, k_b=2e-3, power=2e5, scrub=0.5, lag=0.3, engine_brake=20.0),
        dt=0.04,
    ),
    "single track, linear tires": SingleTrack(params=SOUSA_TABLE_6_1, dt=0.001, tire_f=LINEAR, tire_r=LINEAR),
    "single track, Magic Formula": SingleTrack(
        params=SOUSA_TABLE_6_1, dt=0.001, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2
    ),
    "single track, neural tires": SingleTrack(
        params=SOUSA_TABLE_6_1, dt=0.001, tire_f=neural_tire(), tire_r=neural_tire(combined="ellipse")
    ),
    "single track, Radau": SingleTrack(
        params=SOUSA_TABLE_6_10, dt=0.1, tire_f=SOUSA_TABLE_6_8, tire_r=SOUSA_TABLE_6_8, method="radau"
    ),
    "single track, quasi-steady wheels": QuasiSteadySingleTrack(
        params=SOUSA_TABLE_6_1, dt=0.1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2
    ),
    "pendulum": Pendulum(dt=0.1),
    "NARX": NARXModel(
        network=MLP.random(
            (4, 12, 12, 1),
            activation="elu",
            seed=1,
            input_scaling=Scaling(offset=[0.0, 0.0, 0.0, 0.01], factor=[0.5, 0.5, 0.05, 0.05]),
            output_scaling=Scaling(offset=[0.02], factor=[0.2]),
        ),
        na=2,
        nb=2,
        dt=0.05,
        inputs=("delta",),
        outputs=("r",),
    ),
    "NARX, MIMO, delay": NARXModel(
        network=MLP.random(
            (8, 10, 2),
            activation="tanh",
            seed=2,
            input_scaling=Scaling(offset=[0.0] * 5 + [20.0, 0.0, 20.0], factor=[1.0] * 4 + [0.05, 5.0, 0.05, 5.0]),
        ),
        na=2,
        nb=2,
        nk=3,
        dt=0.1,
        inputs=("delta", "v_x"),
        outputs=("v_y", "r"),
    ),
    "NARX beside a linear path": NARXModel(
        network=replace(
            MLP.random((4, 6, 1), activation="tanh", seed=4, output_scaling=Scaling(offset=[0.1], factor=[0.3])),
            skip=[[1.0, -0.5, 0.3, 0.1]],
        ),
        na=2,
        nb=2,
        dt=0.05,
        inputs=("delta",),
        outputs=("r",),
    ),
    "neural state space": NeuralStateSpaceModel(
        transition=MLP.random(
            (4, 9, 2),
            activation="tanh",
            seed=3,
            output_scaling=Scaling(offset=[0.0, 0.01], factor=[0.2, 0.2]),
            skip=[[-1.0, 0.2, 0.3, 0.0], [0.1, -0.8, 0.2, 0.5]],
        ),
        emission=MLP.random((2, 2), seed=4),
        encoder=MLP.random((10, 6, 2), activation="elu", seed=5),
        lags=3,
        gain=[[0.3, 0.1], [0.0, 0.2]],
        dt=0.05,
        inputs=("delta", "T_f"),
        outputs=("v_y", "r"),
    ),
    "neural state space, feedthrough": NeuralStateSpaceModel(
        transition=MLP.random((4, 3), seed=6, output_scaling=Scaling(offset=[0.0] * 3, factor=[0.1] * 3)),
        emission=MLP.random((4, 5, 1), activation="sigmoid", seed=7),
        encoder=MLP.random((1, 3), seed=8),
        lags=1,
        feedthrough=True,
        dt=0.05,
        inputs=("delta",),
        outputs=("r",),
    ),
    "ARX": ARXModel(A=[-1.5, 0.7], B=[0.1, 0.2, 0.05], dt=0.05, inputs=("delta",), outputs=("r",)),
    "ARX, two inputs, delay, constant": ARXModel(
        A=[-1.2, 0.5, 0.1],
        B=np.array([[[1.0, 0.2]], [[0.3, -0.1]]]),
        c=[0.3],
        nk=2,
        dt=0.1,
        inputs=("delta", "v_x"),
        outputs=("r",),
    ),
    "Box-Jenkins": PolynomialModel(
        A=[],
        B=[[0.5, 0.2], [0.1]],
        C=[0.4],
        D=[-0.8, 0.1],
        F=[[-0.9], [-1.2, 0.5]],
        nk=(1, 3),
        u_offset=[0.01, 0.0],
        y_offset=0.2,
        dt=0.05,
        inputs=("delta", "v_x"),
        outputs=("r",),
    ),
    "ARMAX": PolynomialModel(
        A=[-1.5, 0.7],
        B=[[0.1, 0.2]],
        C=[-0.5],
        D=[],
        F=[[]],
        nk=(1,),
        dt=0.05,
        inputs=("delta",),
        outputs=("r",),
    ),
    "Lur'e": LureModel(
        A=[[0.9, 0.2], [-0.2, 0.8]],
        B=[[0.1], [0.3]],
        C=[[1.0, 0.2]],
        D=[[0.1]],
        W=[[1.0, 0.5], [0.2, -1.0]],
        V=[[0.1], [0.0]],
        E=[[0.1, 0.0], [-0.2, 0.1]],
        u_offset=[0.01],
        y_offset=[0.3],
        dt=0.05,
        inputs=("delta",),
        outputs=("r",),
    ),
    "EMPS, learned friction": Emps(
        params=EmpsParams(mass=90.0, viscous=180.0, coulomb=20.0, offset=-3.0, v_slip=0.5),
        friction=FrictionCurve(centres=[-0.5, 0.5], width=0.3, weights=[2.0, 1.0]),
        dt=0.001,
        outputs=("q",),
    ),
    "state space": StateSpaceModel(
        A=[[0.9, 0.2], [-0.2, 0.85]],
        B=[[0.1, 0.0], [0.3, 0.2]],
        C=[[1.0, 0.0], [0.5, 1.0]],
        D=[[0.0, 0.1], [0.0, 0.0]],
        K=[[0.3, 0.1], [0.0, 0.4]],
        u_offset=[0.01, 0.0],
        y_offset=[0.0, 0.1],
        dt=0.05,
        inputs=("delta", "v_x"),
        outputs=("v_y", "r"),
    ),
    "continuous time, late input": ContinuousTimeModel.of(
        np.array([[-2.0, 4.0], [-4.0, -2.0]]),
        np.array([1.0, 0.5]),
        np.array([1.0, 0.2]),
        delay=0.083,
        dt=0.05,
        inputs=("delta",),
        outputs=("r",),
        y_offset=[0.1],
    ),
    "state space, singular A": StateSpaceModel(
        A=[[0.5, 1.0], [0.0, 0.0]],
        B=[[0.0], [1.0]],
        C=[[1.0, 0.0]],
        K=[[0.2], [0.1]],
        dt=0.05,
        inputs=("delta",),
        outputs=("r",),
    ),
    "ARX, MIMO, delay, constant": ARXModel(
        A=np.array([[[-0.9, 0.1], [0.0, -0.8]], [[0.1, 0.0], [0.05, 0.2]]]),
        B=np.array([[[1.0, 0.2], [0.3, -0.1]]]),
        c=np.array([0.1, -0.2]),
        nk=3,
        dt=0.1,
        inputs=("delta", "v_x"),
        outputs=("v_y", "r"),
    ),
    "ARX, MIMO, direct": ARXModel(
        A=np.array([[[-0.9, 0.1], [0.0, -0.8]], [[0.1, 0.0], [0.05, 0.2]]]),
        B=np.array([[[1.0, 0.2], [0.3, -0.1]], [[0.1, 0.0], [0.2, 0.1]], [[0.0, 0.1], [0.0, 0.1]]]),
        c=np.array([0.1, -0.2]),
        nk=0,
        dt=0.1,
        inputs=("delta", "v_x"),
        outputs=("v_y", "r"),
    ),
    "ARX, direct": ARXModel(A=[-0.7], B=[0.2], nk=0, dt=0.1, inputs=("delta",), outputs=("r",)),
    "dual track, front drive": DualTrack(params=SOUSA_CAR_7, dt=0.001, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE),
    "dual track, aided": DualTrack(
        params=SOUSA_CAR_7,
        dt=0.001,
        tire_f=PASSENGER_TIRE,
        tire_r=PASSENGER_TIRE,
        rear_steered=True,
        torque_vectored=True,
    ),
    "dual track, limited slip, linear tires in front": DualTrack(
        params=BMW_320I,
        dt=0.002,
        tire_f=LINEAR,
        tire_r=PASSENGER_TIRE,
        outputs=("v_x", "r", "a_y", "F_z_fl", "alpha_rr"),
    ),
    "hybrid of a bicycle": HybridModel(
        base=Bicycle(params=FERRARI_250LM, dt=0.05), discrepancy=discrepancy(("delta", "v_x"), ("r",))
    ),
    "hybrid with an input of its own, half": HybridModel(
        base=ARXModel(A=[-1.2, 0.5], B=[0.1, 0.2, 0.1, 0.1], dt=0.05, inputs=("delta",), outputs=("r",)),
        discrepancy=discrepancy(("v_x", "delta"), ("r",)),
        gain=0.5,
    ),
    "hybrid, two outputs, on a state space": HybridModel(
        base=StateSpaceModel(
            A=[[0.9, 0.2], [-0.2, 0.85]],
            B=[[0.1, 0.0], [0.3, 0.2]],
            C=[[1.0, 0.0], [0.5, 1.0]],
            dt=0.05,
            inputs=("delta", "v_x"),
            outputs=("v_y", "r"),
        ),
        discrepancy=discrepancy(("delta", "v_x"), ("v_y", "r")),
    ),
    "equations of one's own": Ode(
        f=spring,
        more=lambda x, u, p: {"a": spring(x, u, p)[1], "power": u[0] * x[1]},
        states=("z", "v"),
        inputs=("F",),
        outputs=("z", "a"),
        params={"mass": (2.0, 0.1, 10.0), "stiffness": (30.0, SI("N/m", "spring", 1.0, 1e3)), "friction": 0.5},
        begin={"v": 0.1},
        dt=0.05,
    ).recorded(),
    "a loop of equations": Ode(
        f=lambda x, z, u, p: [x[1], (z[0] - p.stiffness * x[0]) / p.mass],
        algebraic=lambda x, z, u, p: [z[0] + 0.1 * z[0] * z[0] * z[0] - u[0] + 0.3 * x[1]],
        guess={"drive": lambda x, u, p: 0.5 * u[0]},
        more=lambda x, z, u, p: {"power": z[0] * x[1]},
        states=("z", "v"),
        inputs=("F",),
        outputs=("z", "drive", "power"),
        params={"mass": (2.0, 0.1, 10.0), "stiffness": (30.0, 1.0, 1e3)},
        dt=0.02,
    ).recorded(),
    "implicit rates": Ode(
        implicit=lambda x_dot, x, u, p: [
            x_dot[0] - x[1],
            p.mass * x_dot[1] + 0.3 * x_dot[1] * x_dot[1] * x_dot[1] + p.stiffness * x[0] - u[0],
        ],
        states=("z", "v"),
        inputs=("F",),
        params={"mass": (2.0, 0.1, 10.0), "stiffness": (30.0, 1.0, 1e3)},
        method="radau",
        dt=0.02,
    ).recorded(),
    "bicycle with late steering": Delayed(
        Bicycle(params=FERRARI_250LM, dt=0.05, outputs=("v_y", "r")), delays={"delta": 0.07}, longest=0.1
    ),
    "single track, late steering and torque": Delayed(
        SingleTrack(params=SOUSA_TABLE_6_1, dt=0.001, tire_f=LINEAR, tire_r=LINEAR),
        delays={"delta": 0.0004, "T_r": 0.002},
        longest=0.002,
    ),
    "hybrid, switched off": HybridModel(
        base=Bicycle(params=FERRARI_250LM, dt=0.05), discrepancy=discrepancy(("delta",), ("r",)), gain=0.0
    ),
    "neural bicycle": neural_bicycle(1),
    "neural bicycle, three outputs": neural_bicycle(2, ("r", "v_y", "a_y")),
    "neural bicycle, started from several samples": neural_bicycle(7, memory=5),
    "bicycle with a network for its tires": neural_bicycle(8, ("r", "a_y"), kind=TireNetworkBicycle, reach=0.4),
    "neural bicycle with sensor offsets": OffsetModel(
        model=neural_bicycle(3), inputs_at_zero={"delta": 0.01}, outputs_at_zero={"r": -0.02}
    ),
    "bicycle behind the sensors of another session": OffsetModel(
        model=Bicycle(params=FERRARI_250LM, dt=0.05),
        inputs_at_zero={"delta": 0.01},
        gains={"delta": 1.1},
        lags={"delta": 0.03, "v_x": -0.01},
        outputs_at_zero={"r": -0.02},
    ),
    "ensemble": EnsembleModel(members=(neural_bicycle(4), neural_bicycle(5), neural_bicycle(6))),
    "ensemble of models with other inputs": EnsembleModel(
        members=(
            neural_bicycle(4),
            HybridModel(
                base=Bicycle(params=FERRARI_250LM, dt=0.05), discrepancy=discrepancy(("delta", "v_x"), ("r",), 1)
            ),
        )
    ),
    "ensemble of hybrids": EnsembleModel(
        members=tuple(
            HybridModel(
                base=Bicycle(params=FERRARI_250LM, dt=0.05), discrepancy=discrepancy(("delta", "v_x"), ("r",), seed)
            )
            for seed in (1, 2)
        )
    ),
    "bicycle pushed by a wind": Disturbed(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r", "v_y"))),
    "bicycle that answers late": Lagging(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r", "v_y"))),
    "bicycle on the ground": OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r", "v_y"))),
    "ARX models blended by speed": MultiARXModel(
        models=(
            ARXModel(A=[-1.9, 0.92], B=[0.02, 0.03], dt=0.05, inputs=("delta",), outputs=("Y",)),
            ARXModel(A=[-1.7, 0.9, -0.1], B=[0.1], nk=3, c=[0.1], dt=0.05, inputs=("delta",), outputs=("Y",)),
            ARXModel(A=[-1.8, 0.9], B=[0.2, 0.1], dt=0.05, inputs=("delta",), outputs=("Y",)),
        ),
        speeds=(10.0, 18.3, 24.7),
    ),
    "ARX models side by side": ParallelARX(
        models=(
            ARXModel(A=[-1.9, 0.92], B=[0.02, 0.03], dt=0.05, inputs=("delta",), outputs=("Y",)),
            ARXModel(A=[-1.7, 0.9, -0.1], B=[0.1], nk=3, c=[0.1], dt=0.05, inputs=("delta",), outputs=("Y",)),
            ARXModel(A=[-1.8, 0.9], B=[0.2, 0.1], dt=0.05, inputs=("delta",), outputs=("Y",)),
        ),
        speeds=(10.0, 18.3, 24.7),
    ),
    "smoothly blended ARX models on the ground": OnGround(
        MultiARXModel(
            models=tuple(
                ARXModel(
                    A=np.array([[[-0.6, 0.1], [0.05, -0.7]]]),
                    B=np.array([[[0.3 * k], [0.2]], [[0.1], [0.4 * k]]]),
                    dt=0.05,
                    inputs=("delta",),
                    outputs=("v_y", "r"),
                )
                for k in (1.0, 2.0)
            ),
            speeds=(10.0, 25.0),
            shape="smooth",
        )
    ),
    "ARX on the ground": OnGround(
        ARXModel(A=[-1.5, 0.7], B=[0.1, 0.2, 0.05], dt=0.05, inputs=("delta",), outputs=("r",)), v_y=1.5
    ),
}

# Typical size of each state and input by name; anything else is 1.
SIZE = {
    "v_x": 20.0,
    "omega_f": 50.0,
    "omega_r": 50.0,
    "delta": 0.05,
    "T_f": 300.0,
    "T_r": 300.0,
    "r": 0.3,
    "pedal": 0.5,
}


def typical(model, seed):
    """A random state and input of typical size, driving forward."""
    rng = np.random.default_rng(seed)

    def draw(names):
        size = np.array([SIZE.get(n, 1.0) for n in names])
        base = np.array([1.0 if n in ("v_x", "omega_f", "omega_r") else 0.0 for n in names])
        return size * (base + 0.2 * rng.standard_normal(len(names)))

    x, u = draw(model.states), draw(model.inputs)
    if "omega_f" in model.states:  # wheels near rolling
        i = model.states.index("v_x")
        for n in ("omega_f", "omega_r"):
            x[model.states.index(n)] = x[i] / model.params.radius * (1 + 0.02 * rng.standard_normal())
    for n in ("omega_fl", "omega_fr", "omega_rl", "omega_rr"):
        if n in model.states:
            x[model.states.index(n)] = x[model.states.index("v_x")] / model.params.radius * (1 + 0.02 * rng.normal())
    return x, u
