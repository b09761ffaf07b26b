"""The same fits on other machines: kernels of OpenBLAS, threads, instruction sets of XLA and of the C compiler.

    python -m tests.machines [--only PATTERN] [--combos N] [--jobs N] [--one HASH] [--tests]

Each fit of ``tests/machines/fits_*.py`` runs in a process of its own under each combination. The table shows what its
errors were and how far apart they lie; it fails where the error on the training data differs by more than 1 %, that
on the validation data by more than 3 %, or a bound does not hold.
"""
