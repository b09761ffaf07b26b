"""A whole car from any log of it, with its steering and sensors: start at `identify_car`.

`stretches` cuts a log into pieces for fit and check, `structures` are the corrections that a log may need,
`uncertainty` turns what pieces and structures disagree about into intervals.
"""
