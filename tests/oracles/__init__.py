"""Second opinions: every equation once more in plain NumPy, from the paper and not from the package.

A module without ``test_`` holds equations and imports nothing of slipangle (a test reads that); the ``test_`` module
beside it compares the package with them on random states over the operating range, in numbers and in symbols.
"""
