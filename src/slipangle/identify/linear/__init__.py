"""ARX, ARMAX, output error, Box-Jenkins, subspaces, prediction error, recursive least squares.

Start with `arx.ARX`.
"""
