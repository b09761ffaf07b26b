"""Recordings: the `Dataset` and what is known of one.

Start with ``dataset``. ``readers`` has a file per log format, ``quality`` says what a log is worth, ``public`` are
named data sets, ``signals`` excite a vehicle.
"""
