"""Vehicles, from the kinematic bicycle to four wheels with a driveline.

Start with `vehicles.Bicycle`; `catalogue` has parameter sets with their sources.
"""
