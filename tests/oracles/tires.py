"""Tires in plain NumPy. L. C. Sousa, PhD thesis, PUC-Rio, 2023 (S); H. B. Pacejka, Tire and Vehicle Dynamics, 2012 (P).

Signs of docs/nomenclature.md: slip ratio positive drives, slip angle positive gives a force to the left.
"""

import numpy as np


def sharp_slip(v, omega, radius):
    """S 3-13 with the sign that 3-1 needs: (omega r - v) / max(|v|, |omega r|)."""
    return (omega * radius - v) / np.maximum(np.abs(v), np.abs(omega * radius))


def floor(v, low):
    """|v|, and below ``low`` the parabola through low / 2 that meets it with its slope."""
    return np.where(np.abs(v) > low, np.abs(v), low / 2 + np.square(v) / (2 * low))


def soft_slip(v, omega, radius, low=0.5):
    """The same with both speeds floored and the larger of them taken with a corner of a thousandth of ``low``."""
    a, b = floor(v, low), floor(omega * radius, low)
    return (omega * radius - v) / (0.5 * (a + b) + 0.5 * np.hypot(a - b, 1e-3 * low))


def magic(x, B, C, D, E=0.0, S_h=0.0, S_v=0.0):
    """S 3-16, 3-17."""
    shifted = x + S_h
    phi = (1 - E) * shifted + E / B * np.arctan(B * shifted)
    return D * np.sin(C * np.arctan(B * phi)) + S_v


def similarity(s, alpha, longitudinal, lateral):
    """P sec. 4.2: both curves read at the same normalised slip, shared along its direction.

    Slip is normalised by the slip at which a line of the curve's first slope would reach its peak: each direction by
    its own curve. Curves are dictionaries of `magic`'s coefficients.
    """
    at_x = longitudinal["D"] / (longitudinal["B"] * longitudinal["C"] * longitudinal["D"])
    at_y = lateral["D"] / (lateral["B"] * lateral["C"] * lateral["D"])
    along, across = s / at_x, alpha / at_y
    size = np.sqrt(along**2 + across**2 + 1e-16)
    angle = np.arctan2(across, along)
    length = np.hypot(along, across) / size  # 1 but for the point of no slip
    mu_x = magic(size * at_x, **longitudinal) * np.cos(angle) * length
    mu_y = magic(size * at_y, **lateral) * np.sin(angle) * length
    return mu_x, mu_y


def speeds(s, alpha):
    """Speed of the contact along and across, and of the tread, for a rolling speed and a travel speed of at most 1."""
    travel = np.where(s > 0, 1 - s, 1.0)  # s counts against the larger of the two
    tread = np.where(s > 0, 1.0, 1 + s)
    return travel, travel * np.tan(alpha), tread


def tread_slip(s, alpha):
    """P 3.2: slip velocity over the speed of the tread through the patch."""
    along, across, tread = speeds(s, alpha)
    return (tread - along) / tread, across / tread


def brush(s, alpha, load, *, C_alpha, C_s, mu, half_length):
    """Bristles by summation: force and moment of the deflection that the parabolic pressure lets stick.

    P 3.2: pressure p = 3 F_z / (4 a^3) (a^2 - x^2), bristle stiffness per length c with C = 2 c a^2, deflection sigma
    (a - x) until c times it reaches mu p; one bristle stiffness per direction makes the isotropic case of P where
    C_s = C_alpha. Integrated over 20 000 slices: about 1e-6.
    """
    a = 1.0  # the force does not depend on it
    sigma = np.array(tread_slip(s, alpha))
    x = a * (1 - (np.arange(20_000) + 0.5) / 10_000)
    width = a / 10_000
    c = np.array([C_s, C_alpha]) / (2 * a * a)
    wish = c[:, None] * sigma[:, None] * (a - x)  # force per length without sliding
    bound = mu * 3 * load / (4 * a**3) * (a * a - x * x)
    size = np.hypot(*wish)
    kept = wish * np.minimum(1.0, bound / np.maximum(size, 1e-300))
    F_x, F_y = kept.sum(axis=1) * width
    M_z = (kept[1] * x).sum() * width * half_length
    return F_x, F_y, M_z


def dugoff(s, alpha, load, *, C_alpha, C_s, mu):
    """SAE 700377: linear forces on the tread's slip, times f(lambda) = lambda (2 - lambda) below lambda = 1."""
    sigma_x, sigma_y = tread_slip(s, alpha)
    F = np.array([C_s * sigma_x, C_alpha * sigma_y])
    lam = mu * load / (2 * np.hypot(*F) + 1e-300)
    return F * np.where(lam < 1, lam * (2 - lam), 1.0)


# ---- networks: S 4-15 to 4-20 ------------------------------------------------------------------------------------


def perceptron(x, weights, biases, activation):
    """S 4-20, neuron by neuron, for one sample."""
    f = {
        "sigmoid": lambda z: 1 / (1 + np.exp(-z)),
        "tanh": lambda z: (np.exp(z) - np.exp(-z)) / (np.exp(z) + np.exp(-z)),
        "elu": lambda z: z if z > 0 else np.exp(z) - 1,
    }[activation]
    values = list(x)
    for k, (w, b) in enumerate(zip(weights, biases, strict=True)):
        sums = [sum(w[i][j] * values[j] for j in range(len(values))) + b[i] for i in range(len(b))]
        values = sums if k == len(weights) - 1 else [f(z) for z in sums]
    return values


def radial_basis(x, centres, widths, weights, kernel):
    """S 4-15 to 4-19, neuron by neuron, for one sample; the Gaussian with the minus sign that it needs."""
    f = {
        "gaussian": lambda d, w: np.exp(-((d / w) ** 2)),
        "cubic": lambda d, w: d**3,
        "thin plate": lambda d, w: d * d / w * np.log(d / w),
        "multiquadric": lambda d, w: np.sqrt(d * d + w * w),
    }[kernel]
    found = [
        f(np.sqrt(sum((a - c) ** 2 for a, c in zip(x, row, strict=True))), w)
        for row, w in zip(centres, widths, strict=True)
    ]
    return [sum(a * b for a, b in zip(row, found, strict=True)) for row in weights]
