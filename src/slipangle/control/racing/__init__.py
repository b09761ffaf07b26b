"""Racing: a controller that drives a fastest lap at the limit of grip and learns while it drives.

Start with `racer`; `along_track` has the equations that it plans with, `on_road` those that its filter learns with.
"""
