"""The dual-track car in plain NumPy: four wheels by the vectors from the centre of gravity to them.

L. C. Sousa, PhD thesis, PUC-Rio, 2023, sec. 7.1.1, for what moves; H. B. Pacejka, Tire and Vehicle Dynamics, 2012,
secs. 7.2 and 8.6, for relaxing slip; W. F. Milliken, D. L. Milliken, Race Car Vehicle Dynamics, 1995, ch. 18, for load
transfer through springs, links and unsprung masses. ``p`` is the nested dictionary of a car's numbers, ``x`` and ``u``
are dictionaries of columns; every wheel turns forward.
"""

import numpy as np

G = 9.81
WHEELS = ("fl", "fr", "rl", "rr")


def places(p):
    """Where each wheel stands: x forward, y to the left."""
    l_r, f, r = p["wheelbase"] - p["l_f"], p["track_f"] / 2, p["track_r"] / 2
    return {"fl": (p["l_f"], f), "fr": (p["l_f"], -f), "rl": (-l_r, r), "rr": (-l_r, -r)}


def loads(p, x, grade, bank):
    """Load on each wheel from weight, downforce, springs, dampers, links and unsprung masses."""
    L, l_f = p["wheelbase"], p["l_f"]
    l_r, R = L - l_f, p["radius"]
    mass = {"f": p["mass_unsprung_f"], "r": p["mass_unsprung_r"]}
    body = p["mass"] - mass["f"] - mass["r"]
    press = p["mass"] * G * np.cos(grade) * np.cos(bank)
    pitch = p["pitch_stiffness"] * x["theta"] + p["pitch_damping"] * x["theta_rate"]
    forward = (pitch - (mass["f"] + mass["r"]) * R * x["a_x_lag"]) / L  # braking: a_x < 0 loads the front
    found = {}
    for axle, share, sense in (("f", l_r / L, 1), ("r", l_f / L, -1)):
        lift = 0.5 * p["air_density"] * p["downforce_" + axle] * x["v_x"] ** 2
        both = press * share + lift + sense * forward
        spring = p["roll_stiffness_" + axle] * x["phi"] + p["roll_damping_" + axle] * x["phi_rate"]
        rigid = (body * share * p["roll_centre_" + axle] + mass[axle] * R) * x["a_y_lag"]
        outward = (spring + rigid) / p["track_" + axle]  # to the right in a turn to the left
        found[axle + "l"], found[axle + "r"] = both / 2 - outward, both / 2 + outward
    return {w: np.maximum(found[w], 0) for w in WHEELS}


def steer_angles(p, delta):
    """Of the four wheels: the cotangents of the front ones differ by their track over the wheelbase."""
    half = p["steering"]["ackermann"] * p["track_f"] / p["wheelbase"] / 2
    cot = 1 / np.tan(delta)
    return {"fl": np.arctan(1 / (cot - half)), "fr": np.arctan(1 / (cot + half)), "rl": 0 * delta, "rr": 0 * delta}


def gearbox(p, gear):
    """Engine speed over axle speed."""
    return np.asarray(p["driveline"]["ratios"])[gear.astype(int) - 1] * p["driveline"]["final"]


def engine(p, throttle, speed):
    """Torque that the engine settles to, turning forward."""
    e = p["driveline"]["engine"]
    drag = (e["drag"] + e["drag_slope"] * speed) * np.minimum(speed / e["idle"], 1)
    return throttle * np.interp(speed, e["speeds"], e["torques"]) - (1 - np.abs(throttle)) * drag


def locking(d, faster, drive):
    """Torque that a differential takes from its faster side and gives to the other."""
    rubbing = (d["preload"] + d["locking"] * np.abs(drive)) * np.tanh(faster / d["slip_speed"])
    return (rubbing + d["viscosity"] * faster) / 2


def axle_torques(p, x, ratio):
    """Drive torque of each wheel."""
    d, k = p["driveline"], p["driveline"]["front_share"]
    total = ratio * x["T_e"]
    f, r = (x["omega_fl"] + x["omega_fr"]) / 2, (x["omega_rl"] + x["omega_rr"]) / 2
    moved = locking(d["centre"], f - r, total)
    front, rear = k * total, (1 - k) * total
    left = {
        "f": locking(d["front"], x["omega_fl"] - x["omega_fr"], front),
        "r": locking(d["rear"], x["omega_rl"] - x["omega_rr"], rear),
    }
    front, rear = front - moved, rear + moved
    return {"fl": front / 2 - left["f"], "fr": front / 2 + left["f"], "rl": rear / 2 - left["r"],
            "rr": rear / 2 + left["r"]}  # fmt: skip


def tire_motion(p, x, w, angle, load, friction, tire):
    """Forces in the wheel's plane, aligning moment, rates of both slips."""
    px, py = places(p)[w]
    v = np.array([x["v_x"] - x["r"] * py, x["v_y"] + x["r"] * px])  # velocity of the wheel's centre
    plane, across = (np.array([np.cos(angle + a), np.sin(angle + a)]) for a in (0.0, np.pi / 2))
    v_x, v_y = (v * plane).sum(axis=0), (v * across).sum(axis=0)
    rolling = x["omega_" + w] * p["radius"]
    slip, side = x["slip_" + w], x["side_" + w]
    speed_x, speed = np.maximum(np.abs(v_x), np.abs(rolling)), np.sqrt(v_x**2 + v_y**2 + 1e-12)
    damp = 0.08 * np.clip(1 - speed_x / 2.5, 0, 1) ** 2
    short = 1 + (slip**2 + side**2) / 0.05**2
    sigma_x = np.maximum(p["relaxation_x"] / short, 0.001 * speed_x)
    sigma_y = np.maximum(p["relaxation_y"] / short, 0.001 * speed)
    sense = 1 if py > 0 else -1
    static, roll = p["camber_" + w[0]], p["camber_roll_" + w[0]]
    camber = roll * x["phi"] - sense * static  # tops inward: the left one leans to the right
    tangent = (side - damp * v_y) / np.sqrt(np.maximum(1 - side**2, 1e-4))
    F_x, F_y, M_z = tire(slip + damp * (rolling - v_x), np.arctan(tangent), load, camber, friction)
    M_z = M_z * np.clip(v_x / 2.5, -1, 1)
    return F_x, F_y, M_z, ((rolling - v_x) - speed_x * slip) / sigma_x, (-v_y - speed * side) / sigma_y


def rates(p, tire, road, x, u):
    """Rates of all states by name, and the signals a_x, a_y and the loads.

    ``tire(slip, alpha, load, camber, friction)`` gives F_x, F_y, M_z; ``road`` holds ``places``, ``left``, ``right``,
    ``grade``, ``bank``.
    """
    m, R, at = p["mass"], p["radius"], places(p)
    l_r = p["wheelbase"] - p["l_f"]
    grade, bank = (np.interp(x["distance"], road["places"], road[k]) for k in ("grade", "bank"))
    F_z = loads(p, x, grade, bank)
    angles = steer_angles(p, x["delta_w"] + x["delta_c"])
    angles |= {w: u["delta_r"] for w in ("rl", "rr") if "delta_r" in u}
    F, moment, found, M, rolled = np.zeros((2, len(x["r"]))), 0.0, {}, {}, {}
    for w in WHEELS:
        px, py = at[w]
        friction = np.interp(x["distance"] + px, road["places"], road["left" if py > 0 else "right"])
        F_x, F_y, M[w], slip_rate, side_rate = tire_motion(p, x, w, angles[w], F_z[w], friction, tire)
        found |= {"slip_" + w: slip_rate, "side_" + w: side_rate}
        rolled[w] = (F_x, F_y)
        c, s = np.cos(angles[w]), np.sin(angles[w])
        car = np.array([c * F_x - s * F_y, s * F_x + c * F_y])
        F += car
        moment = moment + px * car[1] - py * car[0] + M[w]
    a_x, a_y = F / m
    air = 0.5 * p["air_density"] * p["drag_area"] * x["v_x"] * np.abs(x["v_x"]) / m
    found["v_x"] = a_x - air - G * np.sin(grade) + x["v_y"] * x["r"]
    found["v_y"] = a_y - G * np.cos(grade) * np.sin(bank) - x["v_x"] * x["r"]
    found["r"] = moment / p["inertia_z"]
    found |= _spins(p, x, F_z, rolled, u.get("M_z", 0.0))

    c, s = np.cos(x["psi"]), np.sin(x["psi"])
    found |= {"X": x["v_x"] * c - x["v_y"] * s, "Y": x["v_x"] * s + x["v_y"] * c, "psi": x["r"], "distance": x["v_x"]}
    unsprung = p["mass_unsprung_f"] + p["mass_unsprung_r"]
    body = m - unsprung
    high = (m * p["height"] - unsprung * R) / body
    arm = high - (p["roll_centre_f"] * l_r + p["roll_centre_r"] * p["l_f"]) / p["wheelbase"]
    K = p["roll_stiffness_f"] + p["roll_stiffness_r"]
    C = p["roll_damping_f"] + p["roll_damping_r"]
    over = body * arm * (a_y + G * x["phi"]) - K * x["phi"] - C * x["phi_rate"]
    nose = -body * high * a_x - p["pitch_stiffness"] * x["theta"] - p["pitch_damping"] * x["theta_rate"]
    found |= {"phi": x["phi_rate"], "phi_rate": over / (p["inertia_x"] + body * arm**2)}
    found |= {"theta": x["theta_rate"], "theta_rate": nose / p["inertia_y"]}
    found |= {"a_x_lag": (a_x - x["a_x_lag"]) / p["load_lag"], "a_y_lag": (a_y - x["a_y_lag"]) / p["load_lag"]}

    steering, brakes = p["steering"], p["brakes"]
    wanted = np.clip(u["delta"], -steering["limit"], steering["limit"])
    turning = (wanted - x["delta_w"]) / steering["lag"]
    found["delta_w"] = np.clip(turning, -steering["rate"], steering["rate"])
    kingpin = sum(M[w] - steering["trail"] * rolled[w][1] for w in ("fl", "fr"))
    found["delta_c"] = (steering["compliance"] * kingpin - x["delta_c"]) / steering["compliance_lag"]
    d = p["driveline"]
    spins = d["front_share"] * (x["omega_fl"] + x["omega_fr"]) + (1 - d["front_share"]) * (
        x["omega_rl"] + x["omega_rr"]
    )
    speed = gearbox(p, x["gear"]) * spins / 2
    found["T_e"] = (engine(p, u["throttle"], speed) - x["T_e"]) / d["engine"]["lag"]
    found["T_bf"] = (brakes["bias"] * brakes["torque"] * u["brake"] - x["T_bf"]) / brakes["lag"]
    found["T_br"] = ((1 - brakes["bias"]) * brakes["torque"] * u["brake"] - x["T_br"]) / brakes["lag"]
    found["gear"] = 0 * x["gear"]
    return found | {"a_x": a_x - air, "a_y": a_y} | {"F_z_" + w: F_z[w] for w in WHEELS}


def _spins(p, x, F_z, rolled, wanted):
    """Angular accelerations: the engine's inertia turns with the wheels, as a full matrix.

    A ``wanted`` yaw moment is a pair of forces along the car at the rear wheels, by their torques.
    """
    ratio, k = gearbox(p, x["gear"]), p["driveline"]["front_share"]
    drive = axle_torques(p, x, ratio)
    push = wanted / (places(p)["rl"][1] - places(p)["rr"][1]) * p["radius"]
    drive |= {"rl": drive["rl"] - push, "rr": drive["rr"] + push}
    share = np.array([k / 2, k / 2, (1 - k) / 2, (1 - k) / 2])
    own = np.array([p["inertia_wheel_f"], p["inertia_wheel_f"], p["inertia_wheel_r"], p["inertia_wheel_r"]]) / 2
    torque = []
    for w in WHEELS:
        brake = x["T_bf" if w[0] == "f" else "T_br"] / 2 + p["rolling_resistance"] * p["radius"] * F_z[w]
        torque.append(drive[w] - rolled[w][0] * p["radius"] - brake)
    seen = p["driveline"]["engine"]["inertia"] * ratio**2
    matrices = np.diag(own) + seen[:, None, None] * np.outer(share, share)
    found = np.linalg.solve(matrices, np.array(torque).T[:, :, None])[:, :, 0].T
    return {"omega_" + w: row for w, row in zip(WHEELS, found, strict=True)}
