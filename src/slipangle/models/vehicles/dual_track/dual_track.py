"""Dual-track car: four wheels with relaxing slip, roll and pitch, driveline, brakes, steering, aerodynamics, road.

Planar motion, four spins and two relaxing slips per wheel are the 11 degrees of freedom of [1]_ ch. 7; body roll and
pitch on springs and dampers move the wheel loads. Everything else is off until a parameter turns it on. Wheels are
numbered 0 to 3: front left, front right, rear left, rear right.

.. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023, sec. 7.1.1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from slipangle.data.channels import Quantity
from slipangle.errors import ParameterError
from slipangle.models.fast import evaluate
from slipangle.models.tires.simple import Tire
from slipangle.models.vehicles.car import DualTrackParams
from slipangle.models.vehicles.driveline import friction_torque, stopped
from slipangle.models.vehicles.dual_track.contact import Contact, Patch, contact
from slipangle.models.vehicles.dual_track.kernel import Kernel
from slipangle.models.vehicles.on_tires import mounted
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.vehicles.road import Road
from slipangle.models.vehicles.single_track import StartsRolling
from slipangle.numerics.integrate import Step, discretise
from slipangle.ops import Scalar, Vector, atan, atan2, clip, cos, fabs, is_symbolic, maximum, sign, sin, sqrt, stack

WHEELS = ("fl", "fr", "rl", "rr")
STATES = (
    *("v_x", "v_y", "r"),
    *(f"omega_{w}" for w in WHEELS),
    *(f"slip_{w}" for w in WHEELS),
    *(f"side_{w}" for w in WHEELS),
    *("X", "Y", "psi", "phi", "phi_rate", "theta", "theta_rate", "a_x_lag", "a_y_lag"),
    *("delta_w", "delta_c", "T_e", "T_bf", "T_br", "gear", "distance"),
)
_AT = {name: i for i, name in enumerate(STATES)}
QUANTITIES = MappingProxyType(
    {
        "throttle": Quantity("-", "throttle, 0 to 1; below zero, to -1, it drives backwards"),
        "brake": Quantity("-", "brake pedal, 0 to 1"),
        "phi": Quantity("rad", "roll of the body, positive right side down"),
        "theta": Quantity("rad", "pitch of the body, positive nose down"),
        "gear": Quantity("-", "gear, 1 the first"),
        "distance": Quantity("m", "distance travelled along the car's x"),
        "engine_speed": Quantity("rad/s", "speed of the engine"),
    }
)


@dataclass(frozen=True, kw_only=True)
class DualTrack(StartsRolling):
    """The car as a plant: throttle, brake and steering in, motion of everything out.

    States, see docs/nomenclature.md: planar motion, wheel spins, relaxed slips, pose, roll and pitch, lagged
    accelerations, actuators, gear and distance. Inputs: delta [rad], throttle (-1 to 1, below zero backwards), brake
    (0 to 1); delta_r [rad] of a car that is ``rear_steered``, M_z [N m] of one that is ``torque_vectored``. Outputs by
    default: v_x, v_y, r, X, Y, psi; `signals` names the others.

    The brakes and rolling resistance are Coulomb friction: their direction is fixed over a step, a wheel that would be
    pushed past zero stops, and stays until a larger torque moves it. Body roll and pitch follow the accelerations and
    move loads and camber; they do not act back on the planar motion, and there is no heave. Raises ParameterError if an
    output is not known or the method is implicit.

    Parameters
    ----------
    tire_f, tire_r : Tire
        Front and rear tire. One that describes a side (``MagicFormulaTire.side``) is mirrored for the other. They are
        used beyond the limits of their files too, as a plant must go on whatever happens.
    road : Road
        Friction per wheel, grade and bank.
    rear_steered : bool
        The rear wheels turn by ``delta_r`` at once, positive to the left.
    torque_vectored : bool
        The right rear wheel gets a torque more and the left one as much less that would turn the car by ``M_z``,
        positive to the left, if the tires bore it and no wheel had inertia.
    dt, outputs, method, substeps
        As for every `OdeModel`, explicit methods only. At a millisecond a step of "rk4" is accurate to 1e-5 or better.
    """

    states = STATES
    inputs = ("delta", "throttle", "brake")
    quantities = QUANTITIES
    max_step: ClassVar[float] = 0.001
    params: DualTrackParams
    tire_f: Tire
    tire_r: Tire
    road: Road = field(default_factory=Road)
    outputs: tuple[str, ...] = ("v_x", "v_y", "r", "X", "Y", "psi")
    rear_steered: bool = field(default=False, metadata={"may be missing in a file": True})
    torque_vectored: bool = field(default=False, metadata={"may be missing in a file": True})

    def __post_init__(self) -> None:
        more = {"delta_r": self.rear_steered, "M_z": self.torque_vectored}
        object.__setattr__(self, "inputs", (*type(self).inputs, *(name for name, there in more.items() if there)))
        if self.method == "radau":
            raise ParameterError('the dual track has stick and slip, which "radau" cannot step over; expected "rk4"')
        if not is_symbolic(self.params.mass_sprung) and self.params.mass_sprung <= 0:
            raise ParameterError(
                f"the unsprung masses sum to {self.params.mass - self.params.mass_sprung:g} kg of "
                f"{self.params.mass:g} kg; expected a heavier body: check their units"
            )
        super().__post_init__()

    @cached_property
    def tires(self) -> tuple[Tire, Tire, Tire, Tire]:
        """The tire of each wheel."""
        front, rear = self.tire_f, self.tire_r
        return mounted(front, "LEFT"), mounted(front, "RIGHT"), mounted(rear, "LEFT"), mounted(rear, "RIGHT")

    def loads(self, x: Vector) -> list[Scalar]:
        """Load on each wheel, never negative. [N]"""
        p = self.params
        place, v_x = x[_AT["distance"]], x[_AT["v_x"]]
        weight = p.mass * GRAVITY
        if self.road.grade or self.road.bank:
            weight = weight * cos(self.road.grade_at(place)) * cos(self.road.bank_at(place))
        air = 0.5 * p.air_density * v_x * v_x
        unsprung = p.mass_unsprung_f + p.mass_unsprung_r
        dive = p.pitch_stiffness * x[_AT["theta"]] + p.pitch_damping * x[_AT["theta_rate"]]
        dive = (dive - unsprung * p.radius * x[_AT["a_x_lag"]]) / p.wheelbase
        phi, p_roll, a_y = x[_AT["phi"]], x[_AT["phi_rate"]], x[_AT["a_y_lag"]]
        wheel_loads = []
        for arm, sense, axle in ((p.l_r, 1.0, "f"), (p.l_f, -1.0, "r")):
            area, stiffness, damping, centre, mass, track = (
                getattr(p, f"{name}_{axle}")
                for name in ("downforce", "roll_stiffness", "roll_damping", "roll_centre", "mass_unsprung", "track")
            )
            half = 0.5 * (weight * (arm / p.wheelbase) + air * area + sense * dive)
            links = p.mass_sprung * arm / p.wheelbase * centre + mass * p.radius
            lean = (stiffness * phi + damping * p_roll + links * a_y) / track
            wheel_loads += [maximum(half - lean, 0.0), maximum(half + lean, 0.0)]
        return wheel_loads

    def patches(self, x: Vector, u: Vector) -> tuple[list[Patch], list[Scalar]]:
        """Every wheel's motion and load, and cosine and sine of the road-wheel angles: front left and right, rear."""
        p, a = self.params, _AT
        steered = (
            clip(p.road_wheel(u[0]), -p.steering.limit, p.steering.limit) if not p.steering.lag else x[a["delta_w"]]
        )
        if p.steering.compliance:
            steered = steered + x[a["delta_c"]]
        turned = [*p.steering.wheels(steered, p.track_f, p.wheelbase)]
        if self.rear_steered:
            rear = u[self.inputs.index("delta_r")]
            turned += 2 * [(cos(rear), sin(rear))]
        v_x, v_y, r, place, phi = x[a["v_x"]], x[a["v_y"]], x[a["r"]], x[a["distance"]], x[a["phi"]]
        loads = self.loads(x)
        places = []
        for i in range(4):
            front, left = i < 2, i % 2 == 0
            track, arm = (p.track_f, p.l_f) if front else (p.track_r, -p.l_r)
            along, across = v_x - (0.5 if left else -0.5) * track * r, v_y + arm * r
            if i < len(turned):
                c, s = turned[i]
                along, across = along * c + across * s, across * c - along * s
            static, roll = (p.camber_f, p.camber_roll_f) if front else (p.camber_r, p.camber_roll_r)
            camber = (-static if left else static) + roll * phi if static or roll else 0.0
            places.append(
                Patch(
                    v_x=along,
                    v_y=across,
                    omega=x[a["omega_fl"] + i],
                    slip=x[a["slip_fl"] + i],
                    side=x[a["side_fl"] + i],
                    load=loads[i],
                    friction=self.road.friction_at(i, place + arm),
                    camber=camber,
                )
            )
        return places, [part for wheel in turned for part in wheel]

    def contact(self, wheel: int, patch: Patch) -> Contact:
        """Forces and slip rates of one wheel at its ``patch`` of road, see `contact`."""
        p = self.params
        return contact(patch, self.tires[wheel], p.relaxation_x, p.relaxation_y, p.radius)

    def forces(self, contacts: Sequence[Contact], angles: Sequence[Scalar]) -> tuple[Scalar, Scalar, Scalar]:
        """Force of the tires along and across the car [N] and their moment about the vertical axis [N m].

        ``contacts`` are those of the four wheels, ``angles`` cosine and sine of the angles of those that are steered.
        """
        p = self.params
        F_x, F_y, M_z = 0.0, 0.0, 0.0
        for i, tire in enumerate(contacts):
            front, left = i < 2, i % 2 == 0
            track, arm = (p.track_f, p.l_f) if front else (p.track_r, -p.l_r)
            along, across = tire.F_x, tire.F_y
            if 2 * i < len(angles):
                c, s = angles[2 * i], angles[2 * i + 1]
                along, across = along * c - across * s, along * s + across * c
            F_x, F_y = F_x + along, F_y + across
            M_z = M_z + arm * across - (0.5 if left else -0.5) * track * along + tire.M_z
        return F_x, F_y, M_z

    def rates(
        self, x: Vector, u: Vector, start: Vector, loads: Sequence[Scalar], contacts: Sequence[Contact], angles: Vector
    ) -> Vector:
        """State derivative from the forces of the tires; ``start`` is the state at the start of the step.

        ``loads`` [N] and ``contacts`` are those of the four wheels, ``angles`` as of `forces`.
        """
        p, a, drive = self.params, _AT, self.params.driveline
        F_x, F_y, M_z = self.forces(contacts, angles)
        v_x, v_y, r, psi = x[a["v_x"]], x[a["v_y"]], x[a["r"]], x[a["psi"]]
        c, s = cos(psi), sin(psi)
        a_x, a_y = F_x / p.mass, F_y / p.mass
        pull_x = a_x - 0.5 * p.air_density * p.drag_area / p.mass * v_x * fabs(v_x) if p.drag_area else a_x
        pull_y = a_y
        if self.road.grade or self.road.bank:
            slope, tilt = self.road.grade_at(x[a["distance"]]), self.road.bank_at(x[a["distance"]])
            pull_x, pull_y = pull_x - GRAVITY * sin(slope), pull_y - GRAVITY * cos(slope) * sin(tilt)

        gear, spins = x[a["gear"]], [x[a["omega_fl"] + i] for i in range(4)]
        T_e = x[a["T_e"]] if drive.engine.lag else drive.engine.torque(u[1], drive.engine_speed(spins, gear))
        driven = [*drive.wheel_torques(spins, T_e, gear)]
        if self.torque_vectored:
            shift = u[self.inputs.index("M_z")] * p.radius / p.track_r
            driven[2], driven[3] = driven[2] - shift, driven[3] + shift
        torques, freedom = [], []
        for i, (most, inertia) in enumerate(zip(self._friction(x, u, loads), self._spin_inertias, strict=True)):
            other = driven[i] - contacts[i].F_x * p.radius
            torque, held = friction_torque(sign(start[a["omega_fl"] + i]), other, most)
            torques.append(other + torque)
            freedom.append((1.0 - held) / inertia)
        spin_rates = drive.spin_rates(torques, freedom, gear)

        roll = p.mass_sprung * p.roll_arm
        phi, phi_rate, theta, theta_rate = (x[a[n]] for n in ("phi", "phi_rate", "theta", "theta_rate"))
        stiffness = p.roll_stiffness_f + p.roll_stiffness_r - roll * GRAVITY
        roll_moment = roll * a_y - stiffness * phi - (p.roll_damping_f + p.roll_damping_r) * phi_rate
        dive = -p.mass_sprung * p.height_sprung * a_x - p.pitch_stiffness * theta - p.pitch_damping * theta_rate
        return stack(
            [
                pull_x + v_y * r,
                pull_y - v_x * r,
                M_z / p.inertia_z,
                *spin_rates,
                *(k.slip_rate for k in contacts),
                *(k.side_rate for k in contacts),
                v_x * c - v_y * s,
                v_x * s + v_y * c,
                r,
                phi_rate,
                roll_moment / (p.inertia_x + roll * p.roll_arm),
                theta_rate,
                dive / p.inertia_y,
                (a_x - x[a["a_x_lag"]]) / p.load_lag,
                (a_y - x[a["a_y_lag"]]) / p.load_lag,
                *self._actuator_rates(x, u, contacts),
                0.0 * gear,
                v_x,
            ]
        )

    def _actuator_rates(self, x: Vector, u: Vector, contacts: Sequence[Contact]) -> list[Scalar]:
        """Rates of delta_w, delta_c, T_e, T_bf, T_br; zero where there is no lag."""
        p, a, drive = self.params, _AT, self.params.driveline
        turned = 0.0 * x[a["delta_c"]]
        if p.steering.compliance:
            moment = sum(k.M_z - p.steering.trail * k.F_y for k in contacts[:2])
            turned = (p.steering.compliance * moment - x[a["delta_c"]]) / p.steering.compliance_lag
        T_e, T_bf, T_br = (x[a[n]] for n in ("T_e", "T_bf", "T_br"))
        engine = 0.0 * T_e
        if drive.engine.lag:
            speed = drive.engine_speed([x[a["omega_fl"] + i] for i in range(4)], x[a["gear"]])
            engine = (drive.engine.torque(u[1], speed) - T_e) / drive.engine.lag
        front, rear = p.brakes.axles(u[2])
        lag = p.brakes.lag
        pressing = ((front - T_bf) / lag, (rear - T_br) / lag) if lag else (0.0 * T_bf, 0.0 * T_br)
        return [p.steering.rate_of(x[a["delta_w"]], p.road_wheel(u[0])), turned, engine, *pressing]

    @property
    def _spin_inertias(self) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        front, rear = 0.5 * self.params.inertia_wheel_f, 0.5 * self.params.inertia_wheel_r
        return front, front, rear, rear

    def _friction(self, x: Vector, u: Vector, loads: Sequence[Scalar]) -> list[Scalar]:
        """Largest friction torque on each wheel, of brake and rolling resistance. [N m]"""
        p = self.params
        front, rear = (x[_AT["T_bf"]], x[_AT["T_br"]]) if p.brakes.lag else p.brakes.axles(u[2])
        brakes = (0.5 * front, 0.5 * front, 0.5 * rear, 0.5 * rear)
        if not p.rolling_resistance:
            return list(brakes)
        return [t + p.rolling_resistance * p.radius * load for t, load in zip(brakes, loads, strict=True)]

    def derivative(self, x: Vector, u: Vector, start: Vector | None = None) -> Vector:
        """Time derivative of the state within a step that started at ``start``, by default here."""
        patches, angles = self.patches(x, u)
        contacts = [self.contact(i, patch) for i, patch in enumerate(patches)]
        return self.rates(x, u, x if start is None else start, [k.load for k in patches], contacts, angles)

    def finish(self, before: Vector, after: Vector, u: Vector) -> Vector:
        """From the state ``before`` a step and that ``after`` it: wheels that stop, the gear, actuators without lag."""
        p, a, drive = self.params, _AT, self.params.driveline
        h = self.dt / self.substeps
        values = {name: after[i] for i, name in enumerate(STATES)}
        if p.rolling_resistance or p.brakes.torque:
            friction = self._friction(after, u, self.loads(after))
            for i, (most, inertia) in enumerate(zip(friction, self._spin_inertias, strict=True)):
                name = STATES[a["omega_fl"] + i]
                values[name] = stopped(before[a["omega_fl"] + i], after[a["omega_fl"] + i], h * most / inertia)
        speed = drive.engine_speed([values[f"omega_{w}"] for w in WHEELS], values["gear"])
        if not drive.engine.lag:
            values["T_e"] = drive.engine.torque(u[1], speed)
        values["gear"] = drive.next_gear(values["gear"], speed)
        if not p.steering.lag:
            values["delta_w"] = clip(p.road_wheel(u[0]), -p.steering.limit, p.steering.limit)
        if not p.brakes.lag:
            values["T_bf"], values["T_br"] = p.brakes.axles(u[2])
        return stack([values[name] for name in STATES])

    @cached_property
    def _step(self) -> Step:
        def substep(x: Vector, u: Vector) -> Vector:
            once = discretise(
                lambda y, v: self.derivative(y, v, x),
                self.dt / self.substeps,
                n_states=self.n_states,
                n_inputs=self.n_inputs,
                method=self.method,
            )
            return self.finish(x, once(x, u), u)

        def step(x: Vector, u: Vector) -> Vector:
            for _ in range(self.substeps):
                x = substep(x, u)
            return x

        return step

    @cached_property
    def kernel(self) -> Kernel | None:
        """The step in compiled C; None without a compiler, then CasADi's virtual machine runs it, slower."""
        return Kernel.build(self)

    @property
    def steps(self) -> Kernel | None:
        """See `kernel`."""
        return self.kernel

    def steps_with(self, names: tuple[str, ...]) -> Kernel | None:
        """See `Kernel.build`."""
        return Kernel.build(self, varied=names)

    def free_run(self, x0: np.ndarray, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """In compiled C where there is a compiler."""
        if self.kernel is None or len(u) < 2:
            return super().free_run(x0, u, out)
        return evaluate(self.functions[1], self.kernel.run(x0, u[:-1])[1:], u[1:])

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Signals besides the states.

        a_x, a_y as an accelerometer at the centre of gravity shows them, beta, engine_speed; per wheel F_x, F_y in the
        wheel's plane, F_z, and alpha, the slip angle that the tire feels.
        """
        patches, angles = self.patches(x, u)
        contacts = [self.contact(i, patch) for i, patch in enumerate(patches)]
        F_x, F_y, _ = self.forces(contacts, angles)
        p = self.params
        drag = 0.5 * p.air_density * p.drag_area * x[0] * fabs(x[0])
        spins = [x[_AT["omega_fl"] + i] for i in range(4)]
        channels = {
            "a_x": (F_x - drag) / p.mass,
            "a_y": F_y / p.mass,
            "beta": atan2(x[1], x[0]),
            "engine_speed": p.driveline.engine_speed(spins, x[_AT["gear"]]),
        }
        for w, patch, tire in zip(WHEELS, patches, contacts, strict=True):
            side = clip(patch.side, -0.99995, 0.99995)
            channels |= {f"F_x_{w}": tire.F_x, f"F_y_{w}": tire.F_y, f"F_z_{w}": patch.load}
            channels[f"alpha_{w}"] = atan(side / sqrt(1.0 - side * side))
        return channels

    def straight(self, v_x: float, *, X: float = 0.0, Y: float = 0.0, psi: float = 0.0) -> np.ndarray:
        """State of straight driving at speed ``v_x`` [m/s] with rolling wheels, in the gear of that speed."""
        omega = v_x / self.params.radius
        known = {"v_x": v_x, "X": X, "Y": Y, "psi": psi, "gear": float(self.params.driveline.gear_at(omega))}
        return np.array([omega if n.startswith("omega_") else known.get(n, 0.0) for n in STATES])
