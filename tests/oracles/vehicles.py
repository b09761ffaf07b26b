"""Vehicles in plain NumPy, from forces and moments of rigid bodies; cars are dictionaries of numbers.

L. C. Sousa, PhD thesis, PUC-Rio, 2023 (S), with the corrections of docs/nomenclature.md: slip ratio positive drives,
slip angle positive gives a force to the left, yaw damping -(C_f l_f^2 + C_r l_r^2) / (I_z v).
"""

import numpy as np

G = 9.81


def turned(angle, x, y):
    """A vector of the frame that is turned by ``angle``, in the frame itself."""
    return np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y


def moment(x, y, F_x, F_y):
    """About the vertical axis, of a force that acts at (x, y)."""
    return x * F_y - y * F_x


def road_wheel(car, logged):
    """Nomenclature: delta_true = steering_gain (delta - steering_offset)."""
    return car.get("steering_gain", 1.0) * (logged - car.get("steering_offset", 0.0))


def kinematic(car, psi, v_x, delta):
    """Rates of X, Y, psi of a car whose axles do not slip: both axles' normals meet in the centre of the turn."""
    L = car["wheelbase"]
    r = v_x * np.tan(delta) / L
    v_y = (L - car["l_f"]) * r  # the rear axle, l_r behind, moves straight ahead: v_y - l_r r = 0
    X, Y = turned(psi, v_x, v_y)
    return [X, Y, r]


def bicycle(car, v_y, r, delta, v_x):
    """S 3-19, 3-20, as the matrices that they are."""
    m, I_z, l_f = car["mass"], car["inertia_z"], car["l_f"]
    l_r, C_f, C_r = car["wheelbase"] - l_f, car["C_f"], car["C_r"]
    v_y_dot = -(C_f + C_r) / (m * v_x) * v_y - ((C_f * l_f - C_r * l_r) / (m * v_x) + v_x) * r + C_f / m * delta
    damping = (C_f * l_f**2 + C_r * l_r**2) / (I_z * v_x)
    r_dot = -(C_f * l_f - C_r * l_r) / (I_z * v_x) * v_y - damping * r + C_f * l_f / I_z * delta
    return [v_y_dot, r_dot]


def longitudinal(car, v_x, pedal):
    """S 3-18, rolling resistance fading out below 0.1 m/s and turning round in reverse."""
    m = car["mass"]
    force = car["k_e"] * pedal - car["k_d"] * v_x - m * G * car["k_r"] * np.tanh(v_x / 0.1)
    return force / m


def driveline(car, v_x, throttle, brake, delta):
    """Force balance of a car from its pedals; what opposes motion follows tanh(v / 1 m/s), uphill is positive."""
    m, v = car["mass"], np.maximum(v_x, 1.0)
    strongest = 1 / np.sqrt(1 / car["k_e"] ** 2 + (v / car["power"]) ** 2)  # the smaller of k_e and power / v, rounded
    grip = car["grip"] * m * G
    resist = grip * np.tanh(car["k_b"] * brake / grip)
    resist = resist + car["drag"] * v_x**2 + car["k_d"] * v_x + car["k_r"] * m * G
    resist = resist + car["engine_brake"] * np.maximum(1 - throttle, 0) * v_x
    resist = resist + m * car["scrub"] * (delta * v_x) ** 2
    return (strongest * throttle - resist * np.tanh(v_x)) / m - G * car["grade"]


def soft(x, width):
    """max(x, 0) with a rounded corner."""
    return (x + np.hypot(x, width)) / 2


def axle(car, alpha, load, static, shift, F_x, C, mu, E):
    """Two tires, one loaded more by ``shift`` and the other less, that share F_x: Magic Formula on what F_x leaves.

    Friction and stiffness per load fall linearly with the relative rise of load; corners are as wide as 0.4 %
    and 4 % of a wheel's load at rest.
    """
    force, rest = 0.0, static / 2
    for wheel in (load / 2 + shift, load / 2 - shift):
        F_z = soft(wheel, 0.004 * rest)
        rise = F_z / rest - 1
        most = soft(mu * F_z * (1 - car["friction_load"] * rise), 0.004 * rest)
        left = np.sqrt(soft(most**2 - (F_x / 2) ** 2, (0.04 * rest) ** 2) + (4e-4 * rest) ** 2)
        K = C / 2 * (1 + rise * (1 - car["stiffness_load"]))
        x = K / (car["shape"] * most) * alpha
        force = force + left * np.sin(car["shape"] * np.arctan(x - E * (x - np.arctan(x))))
    return force


def nonlinear_bicycle(car, v_y, r, delta, v_x, v_x_dot):
    """Rates of v_y and r, front side force: axles saturate and share friction with driving and braking."""
    m, L, l_f = car["mass"], car["wheelbase"], car["l_f"]
    l_r = L - l_f
    static_f, static_r = m * G * l_r / L, m * G * l_f / L
    to_rear = m * v_x_dot * car["transfer_x"]  # accelerating loads the rear axle
    outward = m * v_x * r  # centripetal force: the same for both axles' shares
    F_x = m * v_x_dot + car["drag"] * v_x**2
    driving = soft(F_x, 0.01 * m * G)
    braking = F_x - driving
    F_xf = (1 - car["drive_rear"]) * driving + (1 - car["brake_rear"]) * braking
    F_xr = car["drive_rear"] * driving + car["brake_rear"] * braking
    alpha_f, alpha_r = delta - (v_y + l_f * r) / v_x, -(v_y - l_r * r) / v_x
    F_yf = axle(car, alpha_f, static_f - to_rear, static_f, outward * car["transfer_f"], F_xf,
                car["C_f"], car["mu_f"], car["E_f"])  # fmt: skip
    F_yr = axle(car, alpha_r, static_r + to_rear, static_r, outward * car["transfer_r"], F_xr,
                car["C_r"], car["mu_r"], car["E_r"])  # fmt: skip
    yaw = moment(l_f, 0, 0, F_yf) + moment(-l_r, 0, 0, F_yr)
    return [(F_yf + F_yr) / m - v_x * r, yaw / car["inertia_z"], F_yf]


def saturating_bicycle(car, v_y, r, alpha_f, alpha_r, v_x):
    """Rates of v_y and r, and a_y, from the slip angles that act: D sin(C arctan(B alpha)) of the axles' loads.

    A share ``brush`` of the force is that of brushes. Each carries its share of the weight, its downforce, and what
    braking moves ``forward`` [N]; stiffness and peak are in proportion to what it carries. A force along, ``along_f``
    and ``along_r`` [N], leaves what is on an ellipse a tenth longer than wide, but a fifth at least;
    ``across_f`` [N] is what is across of the one in front, whose wheels are ``turned`` [rad], by default hardly.
    Rear wheels that turn as one have the spin of their centre: each slips along by what its hub is faster or slower,
    and its force points against its slip, as large as the curve says for both slips together.
    """
    m, L, l_f = car["mass"], car["wheelbase"], car["l_f"]
    half, forces, resisting = car.get("locked_half_track", 0.0), [], 0.0
    for alpha, arm, end in ((alpha_f, L - l_f, "f"), (alpha_r, l_f, "r")):
        carried = m * G * arm / L + car.get(f"downforce_{end}", 0.0) * v_x**2
        carried = carried + car.get("forward", 0.0) * (1 if end == "f" else -1)
        stiffness = car[f"C_{end}"] * carried / (m * G * arm / L)
        D, C = car[f"mu_{end}"] * carried, car["shape"]
        across, used = 0.0, car.get(f"along_{end}", 0.0) / (1.1 * D)
        D, stiffness = (x * np.sqrt(np.maximum(1 - used**2, 0.04)) for x in (D, stiffness))
        for side in (half, -half) if end == "r" and half else (0.0, 0.0):
            along = ((v_x - side * r) - v_x) / v_x  # of the hub of a wheel ``side`` to the left, over its tread
            slip = np.hypot(along, alpha)
            force = D * np.sin(C * np.arctan(stiffness / (C * D) * slip))
            if car.get("brush", 0.0):
                force = force + car["brush"] * (brush(stiffness, D, slip) - force)
            force = 0.5 * force / np.where(slip > 0, slip, 1.0)
            across += force * alpha
            resisting += moment(l_f - L, side, -force * along, 0.0)
        forces.append(across)
    forces[0] = forces[0] * np.cos(car.get("turned", 0.0)) + car.get("across_f", 0.0)
    a_y = sum(forces) / m
    yaw = moment(l_f, 0, 0, forces[0]) + moment(l_f - L, 0, 0, forces[1]) + resisting
    return [a_y - v_x * r, yaw / car["inertia_z"], a_y]


def brush(C, D, slip):
    """Force of bristles from the leading edge 0 to the trailing edge 1, by quadrature of what each carries.

    They are dragged aside in proportion to the way since they touched the ground, until that is more than the friction
    under the pressure there, 6 D x (1 - x), allows; C is the slope at no slip.
    """
    nodes, weights = np.polynomial.legendre.leggauss(3)
    slides_from = np.clip(1.0 - C * slip / (3.0 * D), 0.0, 1.0)
    total = 0.0
    for z, w in zip(nodes, weights, strict=True):
        sticking = 0.5 * (1.0 + z) * slides_from
        sliding = slides_from + 0.5 * (1.0 + z) * (1.0 - slides_from)
        total = total + 0.5 * w * slides_from * 2.0 * C * slip * sticking
        total = total + 0.5 * w * (1.0 - slides_from) * 6.0 * D * sliding * (1.0 - sliding)
    return total


def small_slip(car, v_y, r, delta, v_x):
    """Slip angles of both axles where they are small."""
    return delta - (v_y + car["l_f"] * r) / v_x, -(v_y - (car["wheelbase"] - car["l_f"]) * r) / v_x


def wheel_slip(along, across, turned):
    """Slip angle of a wheel whose hub moves so in the car's axes, from the motion in the wheel's own axes."""
    ahead = along * np.cos(turned) + across * np.sin(turned)
    aside = -along * np.sin(turned) + across * np.cos(turned)
    return -np.arctan2(aside, ahead)


def single_track(car, tire, slip, state, inputs):
    """Rates of the eight states, then a_x, a_y, alpha_f, alpha_r: S 3-1 to 3-8 for a car that rolls forward.

    ``tire(front, s, alpha, load)`` gives F_x and F_y of one tire; ``slip(v, omega, radius)`` its slip ratio.
    """
    v_x, v_y, r, omega_f, omega_r, _, _, psi = state
    delta, T_f, T_r = inputs
    m, l_f, R = car["mass"], car["l_f"], car["radius"]
    l_r = car["wheelbase"] - l_f
    load_f, load_r = m * G * l_r / car["wheelbase"] / 2, m * G * l_f / car["wheelbase"] / 2
    alpha_f, alpha_r = delta - np.arctan2(v_y + l_f * r, v_x), -np.arctan2(v_y - l_r * r, v_x)
    rolling_f, _ = turned(-delta, v_x, v_y + l_f * r)  # the front axle's velocity, seen by the wheel
    wheel_f = [2 * F for F in tire(True, slip(rolling_f, omega_f, R), alpha_f, load_f)]
    wheel_r = [2 * F for F in tire(False, slip(v_x, omega_r, R), alpha_r, load_r)]
    front = turned(delta, *wheel_f)
    a_x, a_y = ((front[i] + wheel_r[i]) / m for i in (0, 1))
    yaw = moment(l_f, 0, *front) + moment(-l_r, 0, *wheel_r)
    X, Y = turned(psi, v_x, v_y)
    rates = [a_x + v_y * r, a_y - v_x * r, yaw / car["inertia_z"]]
    rates += [(T_f - wheel_f[0] * R) / car["inertia_wheel_f"], (T_r - wheel_r[0] * R) / car["inertia_wheel_r"]]
    return [*rates, X, Y, r, a_x, a_y, alpha_f, alpha_r]


def quasi_steady(car, tire, grip, state, inputs):
    """Rates of six states: S 3-1 to 3-3 with 3-4, 3-5 solved for the forces of wheels that roll along with the car.

    ``T - F_x radius = inertia v_x' / radius`` for both axles, as three linear equations in v_x', F_xf, F_xr.
    """
    v_x, v_y, r, _, _, psi = state
    delta, T_f, T_r = inputs
    m, l_f, R = car["mass"], car["l_f"], car["radius"]
    L = car["wheelbase"]
    l_r = L - l_f
    F_z = np.array([m * G * l_r / L, m * G * l_f / L])
    F_yf = 2 * tire(True, 0.0, delta - np.arctan2(v_y + l_f * r, v_x), F_z[0] / 2)[1]
    F_yr = 2 * tire(False, 0.0, -np.arctan2(v_y - l_r * r, v_x), F_z[1] / 2)[1]
    most = grip * F_z * R
    T_f, T_r = np.clip(T_f, -most[0], most[0]), np.clip(T_r, -most[1], most[1])
    found = []
    for k in range(len(v_x)):
        A = [[m, -np.cos(delta[k]), -1.0], [car["inertia_wheel_f"] / R, R, 0.0], [car["inertia_wheel_r"] / R, 0.0, R]]
        b = [m * v_y[k] * r[k] - F_yf[k] * np.sin(delta[k]), T_f[k], T_r[k]]
        found.append(np.linalg.solve(A, b))
    rate, F_xf, _ = np.array(found).T
    front = turned(delta, F_xf, F_yf)
    yaw = moment(l_f, 0, *front) + moment(-l_r, 0, 0, F_yr)
    X, Y = turned(psi, v_x, v_y)
    return [rate, (front[1] + F_yr) / m - v_x * r, yaw / car["inertia_z"], X, Y, r]
