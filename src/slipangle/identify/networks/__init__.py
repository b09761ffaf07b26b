"""NARX, neural state space, physics with a network: trained in JAX, handed back as NumPy weights.

Start with `narx.NARX`.
"""
