"""Parameter sets of cars and tires, each with its source."""

import math
from types import SimpleNamespace
from typing import Any

from slipangle.models.tires.magic_formula.coefficients import MF61Coefficients
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.tires.simple import MagicCurve, SimpleMagicFormula
from slipangle.models.vehicles.car import DualTrackParams
from slipangle.models.vehicles.driveline import Brakes, Differential, Driveline, Engine, Steering
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams, SingleTrackParams

# L. C. Sousa, PhD thesis, PUC-Rio, 2023, table 6.1: front-drive car, weight distribution 50/50.
SOUSA_TABLE_6_1 = SingleTrackParams(
    **dict(mass=2500.0, inertia_z=2200.0, wheelbase=2.7, l_f=1.35),
    **dict(inertia_wheel_f=2.5, inertia_wheel_r=2.5, radius=0.42),
)

# The same, table 6.10: rear-drive Formula SAE car.
SOUSA_TABLE_6_10 = SingleTrackParams(
    **dict(mass=270.0, inertia_z=120.0, wheelbase=1.6, l_f=0.8),
    **dict(inertia_wheel_f=0.3, inertia_wheel_r=0.3, radius=0.20),
)

_LOAD_6_2 = 2500.0 * GRAVITY / 4  # N, the wheel load at which table 6.2's D is a force

# Table 6.2 (after its reference 129): B there is per percent and per degree, D in newtons.
SOUSA_TABLE_6_2 = SimpleMagicFormula(
    longitudinal=MagicCurve(B=0.208 * 100, C=1.650, D=6213.4 / _LOAD_6_2, E=0.604),
    lateral=MagicCurve(B=0.154 * 180 / math.pi, C=1.300, D=5367.9 / _LOAD_6_2, E=-1.464),
)

# Table 6.8, converted from the rig's SAE sign to ours (B and C of mu_y are both negative there and
# F_y opposes SA: mu(alpha) = -mu_SAE(-alpha)).
SOUSA_TABLE_6_8 = SimpleMagicFormula(
    longitudinal=MagicCurve(B=10.3075, C=1.9157, D=2.6268, E=0.5182, S_h=0.0322, S_v=-0.2819),
    lateral=MagicCurve(B=10.8138, C=1.6192, D=2.7166, E=0.4118, S_h=-0.0036, S_v=0.0694),
)

# Table 7.2: mass, inertia and geometry; the stiffness is not printed: typical of a large car, to be fitted.
SOUSA_TABLE_7_2 = BicycleParams(mass=2000.0, inertia_z=4000.0, wheelbase=3.0, l_f=1.4, C_f=1.2e5, C_r=1.3e5)

# Ferrari 250 LM, 1964: mass and wheelbase as published with the Revs Program's data; the rest is a start for
# identification (mid-engined: about 42 % of the weight in front).
FERRARI_250LM = BicycleParams(mass=982.0, inertia_z=1200.0, wheelbase=2.4, l_f=1.39, C_f=8e4, C_r=1e5)

# ---- dual-track cars ----------------------------------------------------------------------------------------------

# Passenger car tire of the ADAMS handbook as tabulated in M. Althoff, G. Wuersching, "CommonRoad: Vehicle Models",
# 2020, table 7: peaks, shapes and slip stiffness at nominal load, combined slip; its left/right differences are left
# out. Not in the source: nominal load, how peaks (PDX2, PDY2) and cornering stiffness (PKY1, PKY2, equal to the
# source's -21.92 at nominal load) fall with load, carcass, and the trail: typical of the size.
PASSENGER_TIRE = MagicFormulaTire(
    coefficients=MF61Coefficients(
        **dict(FNOMIN=4500.0, UNLOADED_RADIUS=0.344, LATERAL_STIFFNESS=1.6e5, LONGITUDINAL_STIFFNESS=3.6e5),
        **dict(PCX1=1.6411, PDX1=1.1739, PDX2=-0.08, PEX1=0.46403, PKX1=22.303),
        **dict(RBX1=13.276, RBX2=-13.778, RCX1=1.2568, REX1=0.65225),
        **dict(PCY1=1.3507, PDY1=1.0489, PDY2=-0.06, PEY1=-0.0074722, PKY1=-27.4, PKY2=2.0),
        **dict(RBY1=7.1433, RBY2=9.1916, RCY1=1.0719, REY1=-0.27572),
        **dict(QBZ1=10.0, QCZ1=1.1, QDZ1=0.1, QEZ1=-2.0),
    )
)


def _axles(**pairs: tuple[float, float]) -> dict[str, float]:
    """Fields of the front and of the rear axle."""
    return {f"{name}_{end}": value for name, pair in pairs.items() for end, value in zip("fr", pair, strict=True)}


# Thesis, sec. 7.1.1 and table 7.2: mass, yaw inertia, axles, track; front drive, hydraulic brakes. Not in the source:
# everything else, typical of a large saloon.
SOUSA_CAR_7 = DualTrackParams(
    **dict(mass=2000.0, inertia_z=4000.0, wheelbase=3.0, l_f=1.4, height=0.55, radius=0.33, rolling_resistance=0.012),
    **_axles(track=(1.4, 1.4), inertia_wheel=(2.4, 2.4), mass_unsprung=(100.0, 100.0), roll_centre=(0.05, 0.10)),
    **_axles(roll_stiffness=(55e3, 45e3), roll_damping=(3.5e3, 3.5e3)),
    **dict(inertia_x=600.0, inertia_y=3000.0, pitch_stiffness=150e3, pitch_damping=12e3, drag_area=0.70),
    steering=Steering(limit=0.6, ackermann=1.0),
    brakes=Brakes(torque=9000.0, bias=0.65, lag=0.05),
    driveline=Driveline(
        engine=Engine(
            speeds=(0.0, 150.0, 400.0, 580.0, 680.0),
            torques=(260.0, 320.0, 350.0, 310.0, 0.0),
            **dict(drag=30.0, drag_slope=0.05, inertia=0.2, lag=0.1),
        ),
        ratios=(3.6, 2.1, 1.4, 1.0, 0.8),
        **dict[str, Any](final=3.7, shift_up=560.0, shift_down=250.0, front_share=1.0),
    ),
)

# M. Althoff, G. Wuersching, "CommonRoad: Vehicle Models", 2020, table 6, SI units: vehicle 2 (BMW 320i, after
# measurements of the U.S. Department of Transportation) and vehicle 3 (VW Vanagon). Of two numbers the first is of the
# front axle; camber is per jounce.
_TABLE_6 = {
    "mass": (1093.2952334674046, 1478.8979637767998),
    "sprung": (965.7108098804363, 1316.6086552490374),
    "unsprung": (63.7921826056784, 81.14428941630796),
    "arms": ((1.1561957064, 1.4227170936), (1.1507916024, 1.3211363976000001)),
    "height": (0.61373004, 0.804490644),
    "tracks": ((1.38684, 1.36398), (1.574292, 1.5438120000000002)),
    "inertia_x": (207.26524557936952, 479.88430581318335),
    "inertia_y": (1565.8178787125541, 2204.322715845899),
    "inertia_z": (1791.5995300122856, 2473.1176915564442),
    "springs": ((24453.137879749014, 19635.504745231297), (33577.44305875984, 39125.020607598424)),
    "dampers": ((1786.2441002440723, 1649.0833034887382), (2405.564099800005, 2769.727219182409)),
    "torsion": ((-6914.881688272133, -2643.6009520155308), (-33948.217142834066, -7731.374238208578)),
    "tire_stiffness": (158294.1398119115, 212641.56722464017),
    "camber": ((-0.39370078740157477, -0.905511811023622), (-0.32808398950131235, -0.32808398950131235)),
    "bias": (0.66, 0.64),
}


def _commonroad(vehicle: int, *, driveline: Driveline, drag_area: float) -> DualTrackParams:
    """Parameters of a multi-body car as those of a dual track: roll on springs, bars and tires in series.

    Not in the source: relaxation, rolling and air resistance, engine and gearbox.
    """
    car: Any = SimpleNamespace(**{name: row[vehicle - 2] for name, row in _TABLE_6.items()})
    radius, spin = 0.344, 1.7
    half = [0.5 * t * t for t in car.tracks]
    tire = [h * car.tire_stiffness for h in half]
    body = [h * k - bar for h, k, bar in zip(half, car.springs, car.torsion, strict=True)]
    share = [k / (s + k) for s, k in zip(body, tire, strict=True)]  # of the roll that the suspension takes
    arms = [2 * a * a for a in car.arms]
    rolled = [1.0 + c * 0.5 * t * s for c, t, s in zip(car.camber, car.tracks, share, strict=True)]
    return DualTrackParams(
        **dict(mass=car.mass, inertia_z=car.inertia_z, wheelbase=sum(car.arms), l_f=car.arms[0], radius=radius),
        height=(car.sprung * car.height + 2 * car.unsprung * radius) / car.mass,
        **_axles(track=car.tracks, inertia_wheel=(2 * spin, 2 * spin), mass_unsprung=(car.unsprung, car.unsprung)),
        **_axles(camber_roll=(rolled[0], rolled[1])),
        **_axles(roll_stiffness=(body[0] * share[0], body[1] * share[1])),
        **_axles(roll_damping=(half[0] * car.dampers[0] * share[0] ** 2, half[1] * car.dampers[1] * share[1] ** 2)),
        pitch_stiffness=sum(a * k * s for a, k, s in zip(arms, car.springs, share, strict=True)),
        pitch_damping=sum(a * d * s**2 for a, d, s in zip(arms, car.dampers, share, strict=True)),
        **dict(inertia_x=car.inertia_x, inertia_y=car.inertia_y, rolling_resistance=0.012, drag_area=drag_area),
        steering=Steering(limit=0.7),
        brakes=Brakes(torque=11.5 * car.mass * radius, bias=car.bias),
        driveline=driveline,
    )


BMW_320I = _commonroad(
    2,
    drag_area=0.65,
    driveline=Driveline(
        engine=Engine(torques=(150.0, 170.0, 185.0, 150.0, 0.0), drag=15.0, drag_slope=0.03, inertia=0.15, lag=0.08),
        ratios=(3.72, 2.02, 1.32, 1.0, 0.8),
        **dict[str, Any](final=3.64, shift_up=600.0, shift_down=250.0, front_share=0.0),
        rear=Differential(preload=30.0, locking=0.25),
    ),
)
VW_VANAGON = _commonroad(
    3,
    drag_area=1.4,
    driveline=Driveline(
        engine=Engine(
            speeds=(0.0, 150.0, 280.0, 450.0, 560.0),
            torques=(110.0, 135.0, 150.0, 120.0, 0.0),
            **dict(drag=15.0, drag_slope=0.03, inertia=0.15, lag=0.08),
        ),
        ratios=(3.78, 2.06, 1.26, 0.85),
        **dict[str, Any](final=4.57, shift_up=450.0, shift_down=180.0, front_share=0.0),
    ),
)
