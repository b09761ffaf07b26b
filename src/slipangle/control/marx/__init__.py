"""Predictive control on ARX models blended by speed: one quadratic program a step.

Start with `mpc.MultiARXMPC`.
"""
