"""Mistakes in vehicles, their parts, and their motion over ground."""

from tests.mutants.listed import mistakes

AIDED = "oracles/test_aided.py"
ORACLE = "oracles/test_vehicles.py"
DUAL = "oracles/test_dual_track.py"
MOTION = "oracles/test_motion.py"

MUTANTS = [
    *mistakes(
        "models/vehicles/axle.py",
        ORACLE,
        [
            (
                "axle: slip angle of the rear axle",
                "v_y + p.l_f * r, v_y - p.l_r * r",
                "v_y + p.l_f * r, v_y - p.l_f * r",
            ),
            (
                "axle: slip angle of the front axle",
                "delta * v_x / v - atan2(v_yf, v)",
                "delta * v_x / v + atan2(v_yf, v)",
            ),
            ("axle: sign of the rear slip angle", ", -atan2(v_yr, v)", ", atan2(v_yr, v)"),
            ("axle: small slip angle of the front axle", "delta - v_yf / v", "delta + v_yf / v"),
            (
                "axle: small slip angle of the rear axle",
                "return delta - v_yf / v, -v_yr / v",
                "return delta - v_yf / v, v_yr / v",
            ),
            (
                "axle: slip angle of the rear axle behind turned wheels",
                "atan(v_yf / v), -v_yr / v",
                "atan(v_yf / v), v_yr / v",
            ),
            ("axle: slip angle of turned wheels", "delta - atan(v_yf / v)", "delta + atan(v_yf / v)"),
            (
                "axle: rotation of the side force",
                "F_x * cos(delta) - F_y * sin(delta)",
                "F_x * cos(delta) + F_y * sin(delta)",
            ),
            (
                "axle: rotation of the driving force",
                "F_x * sin(delta) + F_y * cos(delta)",
                "F_y * cos(delta) - F_x * sin(delta)",
            ),
            (
                "axle: rotation to the ground",
                "v_x * sin(psi) + v_y * cos(psi)",
                "v_x * sin(psi) - v_y * cos(psi)",
            ),
        ],
    ),
    *mistakes(
        "models/vehicles/parameters.py",
        ORACLE,
        [
            (
                "static load: axles swapped",
                "0.5 * self.mass * GRAVITY * self.l_r / self.wheelbase",
                "0.5 * self.mass * GRAVITY * self.l_f / self.wheelbase",
            ),
            (
                "sign of the steering's offset",
                "self.steering_gain * (delta - self.steering_offset)",
                "self.steering_gain * (delta + self.steering_offset)",
            ),
        ],
    ),
    *mistakes(
        "models/vehicles/single_track.py",
        ORACLE,
        [
            (
                "single track: speed of the steered wheel",
                "v_wheel = v_x * cos(delta) + v_yf * sin(delta)",
                "v_wheel = v_x * cos(delta) - v_yf * sin(delta)",
            ),
            ("single track: sign in a_x", '"a_x": rate[0] - x[1] * x[2]', '"a_x": rate[0] + x[1] * x[2]'),
            ("single track: sign in a_y", '"a_y": rate[1] + x[0] * x[2]', '"a_y": rate[1] - x[0] * x[2]'),
            ("single track: reported alpha_f", '"alpha_f": alpha_f', '"alpha_f": -alpha_f'),
            ("single track: reported alpha_r", '"alpha_r": alpha_r', '"alpha_r": -alpha_r'),
            (
                "single track: axles swapped in the yaw moment",
                "(p.l_f * across - p.l_r * F_yr) / p.inertia_z,",
                "(p.l_r * across - p.l_f * F_yr) / p.inertia_z,",
            ),
            (
                "single track: rear wheels with the front's inertia",
                "(T_r - F_xr * p.radius) / p.inertia_wheel_r",
                "(T_r - F_xr * p.radius) / p.inertia_wheel_f",
            ),
            ("single track: tire force drives the wheel", "(T_f - F_xf * p.radius)", "(T_f + F_xf * p.radius)"),
            ("single track: one front tire", "2 * front.F_x, 2 * front.F_y", "2 * front.F_x, front.F_y"),
            (
                "single track: rotating frame",
                "(along + F_xr) / p.mass + v_y * r",
                "(along + F_xr) / p.mass - v_y * r",
            ),
        ],
    ),
    *mistakes(
        "models/vehicles/kinematic.py",
        ORACLE,
        [("kinematic: l_f for l_r", "v_y = v_x * p.l_r * slope", "v_y = v_x * p.l_f * slope")],
    ),
    *mistakes(
        "models/vehicles/bicycle.py",
        ORACLE,
        [
            (
                "bicycle: yaw moment of the rear axle",
                "(p.l_f * F_yf - p.l_r * F_yr) / p.inertia_z])",
                "(p.l_f * F_yf + p.l_r * F_yr) / p.inertia_z])",
            ),
            (
                "bicycle: rotating frame",
                "stack([(F_yf + F_yr) / p.mass - v_x * r, (p.l_f",
                "stack([(F_yf + F_yr) / p.mass + v_x * r, (p.l_f",
            ),
        ],
    ),
    *mistakes(
        "models/vehicles/longitudinal.py",
        ORACLE,
        [
            ("longitudinal: rolling resistance pushes", "- GRAVITY * p.k_r * tanh", "+ GRAVITY * p.k_r * tanh"),
            ("longitudinal: drag pushes", "(p.k_e * pedal - p.k_d * v_x)", "(p.k_e * pedal + p.k_d * v_x)"),
        ],
    ),
    *mistakes(
        "models/ode.py",
        ORACLE,
        [
            (
                "sensors: sign of a bias",
                "values[name] + self._bias(name)",
                "values[name] - self._bias(name)",
            ),
        ],
    ),
    *mistakes(
        "models/vehicles/saturating_bicycle.py",
        ORACLE,
        [
            (
                "saturating bicycle: axles' loads swapped",
                "weight * self.l_r, weight * self.l_f",
                "weight * self.l_f, weight * self.l_r",
            ),
            (
                "saturating bicycle: rotating frame",
                "/ p.mass - self.slip_speed(u[1]) * x[1]",
                "/ p.mass + self.slip_speed(u[1]) * x[1]",
            ),
            ("saturating bicycle: peak without the load", "peak = mu * load", "peak = mu"),
            ("saturating bicycle: a brush that slides late", "clip(C / (3.0 * peak)", "clip(C / (4.0 * peak)"),
            (
                "saturating bicycle: lever of the sensor",
                "+ p.gain_v_y * p.lever_v_y * x[1]",
                "- p.gain_v_y * p.lever_v_y * x[1]",
            ),
            ("saturating bicycle: turned by the logged speed", "p.turn_v_y * p.gain_v_x * u[1]", "p.turn_v_y * u[1]"),
            ("relaxing bicycle: time for length", "(length / v) ** 2", "(length * v) ** 2"),
            ("relaxing bicycle: slip runs away", "(now[i] - x[2 + i]) / tau[i]", "(x[2 + i] - now[i]) / tau[i]"),
        ],
    ),
    *mistakes(
        "models/vehicles/aided.py",
        AIDED,
        [
            ("rear steering: the wrong way", "x[i] - away if", "x[i] + away if"),
            ("rear steering: front wheels as they were", "given[i] - turn if", "given[i] if"),
            ("rear steering: the gain of the front", "turn = angle / self.params.steering_gain", "turn = angle"),
            ("rear steering: v_y is that of straight wheels", "read if name in self.states else felt", "felt"),
            ("rear steering: no scale", "self.gain_delta_r * u[car.n_inputs]", "u[car.n_inputs]"),
            ("yaw moment: no scale", "self.gain_M_z * moment", "moment"),
            ("yaw moment: not felt ahead", "y[i] + felt if", "y[i] if"),
        ],
    ),
    *mistakes(
        "models/vehicles/banked.py",
        ORACLE,
        [("bank: pulls uphill", "rates[i] - pull", "rates[i] + pull")],
    ),
    *mistakes(
        "models/vehicles/load_transfer.py",
        ORACLE,
        [
            ("load transfer: braking unloads the front", "p.load_shift - self.height", "p.load_shift + self.height"),
            ("load transfer: a car that turns gains no speed across", "- v_y * r", "+ v_y * r"),
            ("load transfer: the speed as logged", "p.gain_v_x * self._gains", "self._gains"),
            ("load transfer: brakes drive", "self.drive_rear * drive", "self.brake_rear * drive"),
            ("load transfer: the front does what the rear does", "(pushed - rear) /", "rear /"),
            ("load transfer: wheels push where the car points", "along_f=along_f, ", ""),
            ("load transfer: a tire alike both ways", "(used / _ALONG) ** 2", "used**2"),
            ("load transfer: grip of the car at rest", "p.mu_r * loads[1] * p.l_f", "p.mu_r * p.l_f"),
        ],
    ),
    *mistakes(
        "models/vehicles/steering.py",
        ORACLE,
        [
            (
                "steering: lag runs away",
                "- x[self.model.n_states]) / self.steering_lag",
                "+ x[self.model.n_states]) / self.steering_lag",
            ),
            (
                "steering: rate limited one way",
                "maximum(minimum(rate, self.steering_rate), -self.steering_rate)",
                "minimum(rate, self.steering_rate)",
            ),
        ],
    ),
    *mistakes(
        "models/vehicles/nonlinear_bicycle.py",
        ORACLE,
        [
            ("nonlinear bicycle: front share of F_x", "F_x - F_xr, t.C_f", "F_xr, t.C_f"),
            (
                "nonlinear bicycle: driving and braking shares swapped",
                "p.drive_rear * drive + p.brake_rear * brake",
                "p.brake_rear * drive + p.drive_rear * brake",
            ),
            ("nonlinear bicycle: compliance steers in", "- p.compliance * F_yf", "+ p.compliance * F_yf"),
            (
                "nonlinear bicycle: accelerating loads the front",
                "static_f - forward, static_f",
                "static_f + forward, static_f",
            ),
            ("nonlinear bicycle: front load transfer behind", "across * p.transfer_r", "across * p.transfer_f"),
            (
                "nonlinear bicycle: stiffness falls with load",
                "(1.0 + rise * (1.0 - p.stiffness_load))",
                "(1.0 - rise * (1.0 - p.stiffness_load))",
            ),
            ("nonlinear bicycle: F_x of the axle on each tire", "(0.5 * F_x) ** 2", "F_x**2"),
            (
                "nonlinear bicycle: axles swapped at rest",
                "p.mass * GRAVITY * p.l_r / p.wheelbase, ",
                "p.mass * GRAVITY * p.l_f / p.wheelbase, ",
            ),
        ],
    ),
    *mistakes(
        "models/vehicles/longitudinal.py",
        ORACLE,
        [
            ("pedal car: uphill pushes", "- GRAVITY * p.grade", "+ GRAVITY * p.grade"),
            ("pedal car: engine brakes at full throttle", "maximum(1.0 - throttle, 0.0)", "maximum(throttle, 0.0)"),
            ("pedal car: power does not fall with speed", "(p.k_e * v / p.power) ** 2", "(p.k_e / p.power) ** 2"),
        ],
    ),
    *mistakes(
        "models/vehicles/quasi_steady.py",
        ORACLE,
        [
            (
                "quasi-steady: inertias swapped",
                "(p.inertia_wheel_f * cos(delta) + p.inertia_wheel_r)",
                "(p.inertia_wheel_r * cos(delta) + p.inertia_wheel_f)",
            ),
            (
                "quasi-steady: turning wheels push",
                "F_xf - p.inertia_wheel_f * a_x",
                "F_xf + p.inertia_wheel_f * a_x",
            ),
            ("quasi-steady: grip of the axle counted per tire", "2 * self.grip * p.load_f, ", "self.grip * p.load_f, "),
        ],
    ),
    *mistakes(
        "models/vehicles/dual_track/contact.py",
        DUAL,
        [
            (
                "dual track: side slip against the motion",
                "side_rate=(-patch.v_y - speed",
                "side_rate=(patch.v_y - speed",
            ),
        ],
    ),
    *mistakes(
        "models/vehicles/dual_track/dual_track.py",
        DUAL,
        [
            ("rear steering: left wheels only", "turned += 2 * [", "turned += [(1.0, 0.0)] + ["),
            (
                "torque vectoring: the wrong way",
                "driven[2] - shift, driven[3] + shift",
                "driven[2] + shift, driven[3] - shift",
            ),
            ("torque vectoring: half the lever", "* p.radius / p.track_r", "* p.radius / (0.5 * p.track_r)"),
            (
                "dual track: load moves inward",
                "[maximum(half - lean, 0.0), maximum(half + lean, 0.0)]",
                "[maximum(half + lean, 0.0), maximum(half - lean, 0.0)]",
            ),
            (
                "dual track: braking loads the rear",
                '((p.l_r, 1.0, "f"), (p.l_f, -1.0, "r"))',
                '((p.l_r, -1.0, "f"), (p.l_f, 1.0, "r"))',
            ),
            (
                "dual track: yaw moment of driving forces",
                "arm * across - (0.5 if left else -0.5) * track * along + tire.M_z",
                "arm * across + (0.5 if left else -0.5) * track * along + tire.M_z",
            ),
            (
                "dual track: inner wheels run faster",
                "v_x - (0.5 if left else -0.5) * track * r",
                "v_x + (0.5 if left else -0.5) * track * r",
            ),
            (
                "dual track: static camber of the other side",
                "(-static if left else static)",
                "(static if left else -static)",
            ),
            (
                "dual track: gravity rights the leaning body",
                "p.roll_stiffness_r - roll * GRAVITY",
                "p.roll_stiffness_r + roll * GRAVITY",
            ),
            (
                "dual track: squats under braking",
                "dive = -p.mass_sprung * p.height_sprung * a_x",
                "dive = p.mass_sprung * p.height_sprung * a_x",
            ),
            ("dual track: pushed up the bank", "pull_y - GRAVITY * cos(slope)", "pull_y + GRAVITY * cos(slope)"),
            (
                "dual track: rear wheels reach a place first",
                "self.road.friction_at(i, place + arm)",
                "self.road.friction_at(i, place - arm)",
            ),
            (
                "dual track: roll inertia about the wrong axis",
                "p.inertia_x + roll * p.roll_arm",
                "p.inertia_x - roll * p.roll_arm",
            ),
        ],
    ),
    *mistakes(
        "codegen/integrators.py",
        DUAL,
        [
            (
                "Runge-Kutta in C: third slope a whole step on",
                "y[i] = x[i] + {half} * k[i]; }}",
                "y[i] = x[i] + {h} * k[i]; }}",
            )
        ],
    ),
    *mistakes(
        "models/vehicles/driveline.py",
        DUAL,
        [
            (
                "brakes: bias swapped",
                "return self.bias * total, (1.0 - self.bias) * total",
                "return (1.0 - self.bias) * total, self.bias * total",
            ),
            (
                "Ackermann: outer wheel turns more",
                "slope / (1.0 - (side * 0.5 * self.ackermann)",
                "slope / (1.0 + (side * 0.5 * self.ackermann)",
            ),
            (
                "differential: torque to the faster side",
                "torques[a], torques[b] = torques[a] - torque, torques[b] + torque",
                "torques[a], torques[b] = torques[a] + torque, torques[b] - torque",
            ),
            ("engine's inertia: share not squared", "sum(a * a * freedom[i] for", "sum(a * freedom[i] for"),
        ],
    ),
    *mistakes(
        "models/wrappers/on_ground.py",
        MOTION,
        [
            ("pose: heading at the middle", "psi + h * (3 * r0 + r1) / 8", "psi + h * (r0 + 3 * r1) / 8"),
            ("pose: heading at the end", "psi + h * (r0 + r1) / 2", "psi + h * r0"),
            ("pose: Simpson's weight", "psi_m, 4)", "psi_m, 2)"),
            ("pose: rotation to the ground", "(v_x * sin(a) + v_y * cos(a))", "(v_x * sin(a) - v_y * cos(a))"),
            ("pose: point that does not slip ahead", "return v_x, self.v_y * r, r", "return v_x, -self.v_y * r, r"),
        ],
    ),
    *mistakes(
        "models/wrappers/delayed.py",
        MOTION,
        [
            ("late input: extrapolation", "weights[1] - ahead", "weights[1] + ahead"),
            (
                "late input: half of the kernel",
                "near = (1.5 * z - 2.5) * z * z + 1.0",
                "near = (1.5 * z - 2.0) * z * z + 1.0",
            ),
        ],
    ),
    *mistakes(
        "numerics/integrate.py",
        MOTION,
        [
            ("Runge-Kutta: third slope", "k3 = f(x + 0.5 * h * k2, u)", "k3 = f(x + 0.5 * h * k1, u)"),
            ("Radau: sign of a root", "(296 - 169 * _ROOT6) / 1800", "(296 + 169 * _ROOT6) / 1800"),
        ],
    ),
    *mistakes(
        "reproduce/plants/pendulum.py",
        MOTION,
        [("pendulum: centrifugal force", "- ml * sin(theta) * omega * omega", "+ ml * sin(theta) * omega * omega")],
    ),
]
