"""One optimal control problem, and who solves it.

Start with `ocp.OCP`; ``ipopt`` is the reference solver, ``realtime`` the fast one.
"""
