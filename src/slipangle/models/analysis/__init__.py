"""Linear analysis: a model around an operating point, its poles and responses, its handling over speed.

Start with `linearize.linearize`; `handling.handling` has the quantities of ISO 4138, 7401 and 13674 over speed.
"""
