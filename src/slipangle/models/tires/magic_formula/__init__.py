"""The Magic Formula 5.2, 6.1 and 6.2 as ``.tir`` files have it.

Start with `tire.MagicFormulaTire`; the equations are in ``mf52``, ``mf61`` and what they share, ``terms``.
"""
