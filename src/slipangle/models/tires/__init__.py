"""Tires: from slip and load to force.

Start with `simple`: what a tire is, a linear one and a simple Magic Formula.
"""
