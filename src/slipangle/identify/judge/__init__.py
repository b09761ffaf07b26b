"""Verdicts on models: free run beside one-step-ahead, comparisons, cross-validation, predictive intervals.

Start with `validate.validate`.
"""
