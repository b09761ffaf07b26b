"""C from models: CasADi expressions and networks written as C, compiled once, kept in a checked cache, loaded.

Start with `compiler.library`; `expression.emit` writes a CasADi function, `network.emit_forward` a perceptron, both
on the elementary functions of `expression.preamble`; `integrators.explicit_step` steps rates so written.
"""
