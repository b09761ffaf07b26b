"""Steps in time and motion over ground in plain NumPy.

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996 (H); R. G. Keys, IEEE Trans. ASSP 29, 1981 (K).
"""

import numpy as np


def collocation(nodes):
    """Matrix and weights of the collocation method with these nodes: integrals of Lagrange polynomials. H IV.5."""
    n = len(nodes)
    A = np.zeros((n, n))
    for j in range(n):
        polynomial = np.poly1d([1.0])
        for k in range(n):
            if k != j:
                polynomial = polynomial * np.poly1d([1.0, -nodes[k]]) / (nodes[j] - nodes[k])
        integral = polynomial.integ()
        A[:, j] = [integral(c) for c in nodes]
    return A, A[-1]


def radau_nodes():
    """Roots of the second derivative of x^2 (x - 1)^3, that is of 10 x^3 - 18 x^2 + 9 x - 1. H IV.5.1."""
    polynomial = np.poly1d([1.0, 0.0, 0.0]) * np.poly1d([1.0, -1.0]) ** 3
    return np.sort(polynomial.deriv(2).roots.real)


CLASSICAL = (np.array([[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1, 0]]), np.array([1, 2, 2, 1]) / 6)


def runge_kutta(f, x, h, tableau):
    """One step of any Runge-Kutta method; implicit stages by repetition, so ``h`` must be short for the equation."""
    A, b = tableau
    k = np.array([f(x)] * len(b))
    for _ in range(30):
        k = np.array([f(x + h * row @ k) for row in A])
    return x + h * b @ k


def stability(z, method):
    """R(z) of a step on x' = lambda x with z = h lambda: what one step multiplies x by. H IV.2, IV.3."""
    if method == "euler":
        return 1 + z
    if method == "rk4":
        return 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24
    return (1 + 2 / 5 * z + z**2 / 20) / (1 - 3 / 5 * z + 3 / 20 * z**2 - z**3 / 60)  # Pade (2, 3)


def over_ground(pose, h, before, after):
    """X, Y, psi after ``h``, velocities and yaw rate linear in time: psi exactly, the place by Simpson's rule.

    ``before`` and ``after`` are v_x, v_y, r at both ends.
    """
    before, after = np.asarray(before, dtype=float), np.asarray(after, dtype=float)
    X, Y, psi = pose

    def now(t):
        """Velocity over ground and heading at the share t of the step."""
        v_x, v_y, _ = (1 - t) * before + t * after
        turned = psi + h * (before[2] * t + (after[2] - before[2]) * t * t / 2)
        direction = np.exp(1j * turned)
        return (v_x + 1j * v_y) * direction, turned

    way = h / 6 * (now(0.0)[0] + 4 * now(0.5)[0] + now(1.0)[0])
    return [X + way.real, Y + way.imag, now(1.0)[1]]


def over_ground_exactly(pose, h, before, after):
    """The same by Gauss-Legendre quadrature with 20 points."""
    before, after = np.asarray(before, dtype=float), np.asarray(after, dtype=float)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    way = 0.0
    for t, w in zip((nodes + 1) / 2, weights / 2, strict=True):
        v_x, v_y, _ = (1 - t) * before + t * after
        turned = pose[2] + h * (before[2] * t + (after[2] - before[2]) * t * t / 2)
        way = way + h * w * (v_x + 1j * v_y) * np.exp(1j * turned)
    return [pose[0] + way.real, pose[1] + way.imag, pose[2] + h * (before[2] + after[2]) / 2]


def late(samples, position):
    """Value ``position`` samples back, newest sample first: cubic through the four around it. K eq. 15.

    Between samples 1 and 2 back it is the Catmull-Rom spline: values and central slopes at both ends. Ahead of the
    newest sample the line through the last two goes on; older than the oldest nothing counts.
    """
    line = [2 * samples[0] - samples[1], *samples, 0.0, 0.0]  # entry j + 1 is j samples back
    j = int(np.floor(position))
    a, b, c, d = line[j : j + 4]
    t = position - j
    slope_b, slope_c = (c - a) / 2, (d - b) / 2
    return (
        (1 + 2 * t) * (1 - t) ** 2 * b
        + t * (1 - t) ** 2 * slope_b
        + t * t * (3 - 2 * t) * c
        + t * t * (t - 1) * slope_c
    )


def pendulum(x, F, *, M=10.0, m=80.0, J=100.0, length=1.0, c=0.1, gamma=0.01, g=9.8):
    """K. J. Astrom, R. M. Murray, Feedback Systems, 2008, eq. 2.9: the mass matrix as it stands there."""
    _, angle, v, omega = x
    coupling = -m * length * np.cos(angle)
    mass = np.array([[M + m, coupling], [coupling, J + m * length**2]])
    forces = [F - c * v - m * length * np.sin(angle) * omega**2, m * g * length * np.sin(angle) - gamma * omega]
    return np.array([v, omega, *np.linalg.solve(mass, forces)])
