"""Named public data sets, with origin, licence and checksum.

Start with `sets.public`.
"""
