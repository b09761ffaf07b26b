"""Controllers: what to do with a state and a reference.

Start with `mpc.MPC`. All are a `controller.Controller`; ``marx`` is predictive control on ARX models, ``followers``
the classic path followers, ``speed`` holds a speed.
"""
