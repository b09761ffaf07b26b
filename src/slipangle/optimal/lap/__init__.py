"""The fastest lap of a car: line of least curvature, quasi-steady speeds, then the time-optimal transient lap.

Start with `fastest_lap`; `car` has the equations.
"""
