"""Plausible mistakes in the source, each of which a named test file must catch: ``python -m tests.mutants``.

`listed` says what a mutant is; the lists are in `vehicles`, `tires`, `methods` and `orders`.
"""
