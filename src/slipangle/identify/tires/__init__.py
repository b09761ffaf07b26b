"""Tires from rig data: friction curves, whole tires, Magic Formula coefficients.

Start with `whole_tire.TireFit`, or `magic_formula.MagicFormulaFit` for a ``.tir`` file.
"""
