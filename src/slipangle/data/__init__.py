"""Recordings: the `Dataset`, readers for log formats, public data sets, excitation signals, paths."""
