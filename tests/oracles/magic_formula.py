"""Magic Formula 6.1 and 5.2 in plain NumPy, ISO-W axes, all scaling factors 1, forward at the reference speed.

6.1: H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, eqs. 4.E1 to 4.E78. 5.2: the second edition, 2006.
``p`` is a dictionary of coefficients; slip ratio is that of tire files, (omega r - v) / |v|.
"""

import numpy as np
from numpy import abs, arctan, cos, exp, sign, sin, sqrt, tan


def curve(x, C, E):
    """C arctan{x - E (x - arctan x)}, the inside of every sine and cosine of the formula."""
    return C * arctan(x - E * (x - arctan(x)))


def mf61(p, kappa, alpha, F_z, gamma, pressure):
    """Forces and moments of version 6.1: F_x, F_y, M_x, M_z."""
    g = sin(gamma)  # 4.E4
    a = tan(alpha)  # 4.E3
    df, dp = F_z / p["FNOMIN"] - 1, pressure / p["NOMPRES"] - 1  # 4.E2
    F_x, K_x = _along_61(p, kappa, F_z, df, dp, gamma)
    F_y0, D_y, C_y, B_y, K_y, S_Hy, S_Vy = _across_61(p, a, F_z, df, dp, g)
    G_x = _weight(
        a,
        p["RHX1"],
        (p["RBX1"] + p["RBX3"] * g**2) * cos(arctan(p["RBX2"] * kappa)),
        p["RCX1"],
        p["REX1"] + p["REX2"] * df,
    )  # 4.E51 to 4.E57
    S_Hyk = p["RHY1"] + p["RHY2"] * df
    slope = cos(arctan(p["RBY2"] * (a - p["RBY3"])))
    E_yk = p["REY1"] + p["REY2"] * df
    G_y = _weight(kappa, S_Hyk, (p["RBY1"] + p["RBY4"] * g**2) * slope, p["RCY1"], E_yk)  # 4.E59 to 4.E65
    D_Vyk = D_y * (p["RVY1"] + p["RVY2"] * df + p["RVY3"] * g) * cos(arctan(p["RVY4"] * a))
    S_Vyk = D_Vyk * sin(p["RVY5"] * arctan(p["RVY6"] * kappa))  # 4.E66, 4.E67
    F_x, F_y = G_x * F_x, G_y * F_y0 + S_Vyk

    # aligning moment, 4.E33 to 4.E48 and 4.E71 to 4.E78
    R = p["UNLOADED_RADIUS"]
    alpha_t = a + p["QHZ1"] + p["QHZ2"] * df + (p["QHZ3"] + p["QHZ4"] * df) * g
    alpha_r = a + S_Hy + S_Vy / K_y
    B_t = (p["QBZ1"] + p["QBZ2"] * df + p["QBZ3"] * df**2) * (1 + p["QBZ4"] * g + p["QBZ5"] * abs(g))
    D_t0 = F_z * R / p["FNOMIN"] * (p["QDZ1"] + p["QDZ2"] * df) * (1 - p["PPZ1"] * dp)
    D_t = D_t0 * (1 + p["QDZ3"] * abs(g) + p["QDZ4"] * g**2)
    E_t = p["QEZ1"] + p["QEZ2"] * df + p["QEZ3"] * df**2
    E_t *= 1 + (p["QEZ4"] + p["QEZ5"] * g) * 2 / np.pi * arctan(B_t * p["QCZ1"] * alpha_t)
    D_r = (
        F_z
        * R
        * (
            p["QDZ6"]
            + p["QDZ7"] * df
            + (p["QDZ8"] + p["QDZ9"] * df) * (1 + p["PPZ2"] * dp) * g
            + (p["QDZ10"] + p["QDZ11"] * df) * g * abs(g)
        )
        * cos(alpha)
    )
    B_r = p["QBZ9"] + p["QBZ10"] * B_y * C_y
    both = (K_x / K_y * kappa) ** 2
    t_eq, r_eq = (np.where(x < 0, -1, 1) * sqrt(x**2 + both) for x in (alpha_t, alpha_r))
    trail = D_t * cos(curve(B_t * t_eq, p["QCZ1"], np.minimum(E_t, 1))) * cos(alpha)
    residual = D_r * cos(arctan(B_r * r_eq))
    upright = _across_61(p, a, F_z, df, dp, 0.0)[0] * _weight(kappa, S_Hyk, p["RBY1"] * slope, p["RCY1"], E_yk)
    arm = R * (p["SSZ1"] + p["SSZ2"] * F_y / p["FNOMIN"] + (p["SSZ3"] + p["SSZ4"] * df) * g)
    M_z = -trail * upright + residual + arm * F_x

    # overturning moment, 4.E69, with the three terms of version 6.2
    wide = cos(p["QSX5"] * arctan(p["QSX6"] * F_z / p["FNOMIN"]) ** 2)
    M_x = p["QSX1"] - p["QSX2"] * gamma * (1 + p["PPMX1"] * dp) + p["QSX3"] * F_y / p["FNOMIN"]
    M_x += p["QSX4"] * wide * sin(p["QSX7"] * gamma + p["QSX8"] * arctan(p["QSX9"] * F_y / p["FNOMIN"]))
    M_x += p["QSX10"] * arctan(p["QSX11"] * F_z / p["FNOMIN"]) * gamma
    M_x = R * F_z * M_x + R * (F_y * (p["QSX13"] + p["QSX14"] * abs(gamma)) - p["QSX12"] * F_z * gamma * abs(gamma))
    return F_x, F_y, M_x, M_z


def _along_61(p, kappa, F_z, df, dp, gamma):
    """F_x0 and K_x, 4.E9 to 4.E18."""
    D = F_z * (p["PDX1"] + p["PDX2"] * df) * (1 + p["PPX3"] * dp + p["PPX4"] * dp**2) * (1 - p["PDX3"] * gamma**2)
    K = F_z * (p["PKX1"] + p["PKX2"] * df) * exp(p["PKX3"] * df) * (1 + p["PPX1"] * dp + p["PPX2"] * dp**2)
    x = kappa + p["PHX1"] + p["PHX2"] * df
    E = (p["PEX1"] + p["PEX2"] * df + p["PEX3"] * df**2) * (1 - p["PEX4"] * sign(x))
    F = D * sin(curve(K / (p["PCX1"] * D) * x, p["PCX1"], np.minimum(E, 1)))
    return F + F_z * (p["PVX1"] + p["PVX2"] * df), K


def _across_61(p, a, F_z, df, dp, g):
    """F_y0, D_y, C_y, B_y, K_y, S_Hy, S_Vy, 4.E19 to 4.E30."""
    C = p["PCY1"]
    D = F_z * (p["PDY1"] + p["PDY2"] * df) * (1 + p["PPY3"] * dp + p["PPY4"] * dp**2) * (1 - p["PDY3"] * g**2)
    top = (p["PKY2"] + p["PKY5"] * g**2) * (1 + p["PPY2"] * dp)
    K = p["PKY1"] * p["FNOMIN"] * (1 + p["PPY1"] * dp) * (1 - p["PKY3"] * abs(g))
    K = K * sin(p["PKY4"] * arctan(F_z / p["FNOMIN"] / top))
    S_Vg = F_z * (p["PVY3"] + p["PVY4"] * df) * g
    S_V = F_z * (p["PVY1"] + p["PVY2"] * df) + S_Vg
    K_g = F_z * (p["PKY6"] + p["PKY7"] * df) * (1 + p["PPY5"] * dp)
    S_H = p["PHY1"] + p["PHY2"] * df + (K_g * g - S_Vg) / K
    x = a + S_H
    E = (p["PEY1"] + p["PEY2"] * df) * (1 + p["PEY5"] * g**2 - (p["PEY3"] + p["PEY4"] * g) * sign(x))
    B = K / (C * D)
    return D * sin(curve(B * x, C, np.minimum(E, 1))) + S_V, D, C, B, K, S_H, S_V


def _weight(x, S_H, B, C, E):
    """A cosine Magic Formula that is 1 at x = 0."""
    E = np.minimum(E, 1)
    return cos(curve(B * (x + S_H), C, E)) / cos(curve(B * S_H, C, E))


def mf52(p, kappa, alpha, F_z, gamma):
    """Forces of version 5.2 at nominal pressure: F_x, F_y. Slip and camber are tan(alpha) and sin(gamma) here too."""
    g, a, df = sin(gamma), tan(alpha), F_z / p["FNOMIN"] - 1
    F_x, _ = _along_61(p, kappa, F_z, df, 0.0, g)
    D = F_z * (p["PDY1"] + p["PDY2"] * df) * (1 - p["PDY3"] * g**2)
    K = p["PKY1"] * p["FNOMIN"] * sin(2 * arctan(F_z / (p["PKY2"] * p["FNOMIN"]))) * (1 - p["PKY3"] * abs(g))
    S_H = p["PHY1"] + p["PHY2"] * df + p["PHY3"] * g
    S_V = F_z * (p["PVY1"] + p["PVY2"] * df + (p["PVY3"] + p["PVY4"] * df) * g)
    x = a + S_H
    E = (p["PEY1"] + p["PEY2"] * df) * (1 - (p["PEY3"] + p["PEY4"] * g) * sign(x))
    F_y = D * sin(curve(K / (p["PCY1"] * D) * x, p["PCY1"], np.minimum(E, 1))) + S_V
    G_x = _weight(a, p["RHX1"], p["RBX1"] * cos(arctan(p["RBX2"] * kappa)), p["RCX1"], p["REX1"] + p["REX2"] * df)
    slope = p["RBY1"] * cos(arctan(p["RBY2"] * (a - p["RBY3"])))
    G_y = _weight(kappa, p["RHY1"] + p["RHY2"] * df, slope, p["RCY1"], p["REY1"] + p["REY2"] * df)
    S_Vyk = D * (p["RVY1"] + p["RVY2"] * df + p["RVY3"] * g) * cos(arctan(p["RVY4"] * a))
    return G_x * F_x, G_y * F_y + S_Vyk * sin(p["RVY5"] * arctan(p["RVY6"] * kappa))
