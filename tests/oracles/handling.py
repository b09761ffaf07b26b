"""The linear bicycle's answers in closed form; cars are dictionaries of numbers.

M. Mitschke, H. Wallentowitz, Dynamik der Kraftfahrzeuge, 5th ed., 2014, part C; J. R. Ellis, Vehicle Handling Dynamics,
1994, ch. 2: yaw rate and side slip to the road-wheel angle as second-order transfer functions over speed.
"""

import math


def gradient(car):
    """Understeer gradient from the axles' stiffnesses and loads. [rad/(m/s2)]"""
    L, l_f = car["wheelbase"], car["l_f"]
    return car["mass"] / L * ((L - l_f) / car["C_f"] - l_f / car["C_r"])


def yaw_gain(car, v):
    """v / (L + K v^2). [1/s]"""
    return v / (car["wheelbase"] + gradient(car) * v**2)


def sideslip_gain(car, v):
    """(l_r - m l_f v^2 / (C_r L)) / (L + K v^2). [-]"""
    L, l_f = car["wheelbase"], car["l_f"]
    return (L - l_f - car["mass"] * l_f * v**2 / (car["C_r"] * L)) / (L + gradient(car) * v**2)


def frequency_and_damping(car, v):
    """Of s^2 + 2 zeta omega s + omega^2. [rad/s], [-]"""
    m, I_z, L, l_f, C_f, C_r = (car[n] for n in ("mass", "inertia_z", "wheelbase", "l_f", "C_f", "C_r"))
    l_r = L - l_f
    omega = math.sqrt(C_f * C_r * L**2 / (m * I_z * v**2) + (C_r * l_r - C_f * l_f) / I_z)
    twice = (C_f + C_r) / (m * v) + (C_f * l_f**2 + C_r * l_r**2) / (I_z * v)
    return omega, twice / (2 * omega)


def yaw_zero(car, v):
    """Zero of the yaw rate to the steering angle. [rad/s]"""
    return -car["C_r"] * car["wheelbase"] / (car["mass"] * v * car["l_f"])


def yaw_response(car, v, s):
    """Transfer function G (1 + T_z s) / (1 + 2 zeta s / omega + s^2 / omega^2) at complex s."""
    omega, zeta = frequency_and_damping(car, v)
    return yaw_gain(car, v) * (1 - s / yaw_zero(car, v)) / (1 + 2 * zeta / omega * s + (s / omega) ** 2)


def yaw_step(car, v, t):
    """Yaw rate after a unit step of the steering, underdamped."""
    omega, zeta = frequency_and_damping(car, v)
    turns, decay = omega * math.sqrt(1 - zeta**2), zeta * omega
    sine = (decay + omega**2 / yaw_zero(car, v)) / turns
    return yaw_gain(car, v) * (1 - math.exp(-decay * t) * (math.cos(turns * t) + sine * math.sin(turns * t)))


def yaw_peak(car, v):
    """Time at which the step response is largest: its rate, an impulse response, passes zero first. [s]"""
    omega, zeta = frequency_and_damping(car, v)
    turns, decay = omega * math.sqrt(1 - zeta**2), zeta * omega
    lead = -1 / yaw_zero(car, v)  # impulse response ~ lead cos + (1 - lead decay) / turns sin
    return (math.pi - math.atan2(turns * lead, 1 - lead * decay)) / turns


def characteristic_speed(car):
    """Where v / (L + K v^2) is largest. [m/s]"""
    return math.sqrt(car["wheelbase"] / gradient(car))


def critical_speed(car):
    """Where L + K v^2 vanishes, of an oversteering car. [m/s]"""
    return math.sqrt(-car["wheelbase"] / gradient(car))
