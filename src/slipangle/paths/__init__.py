"""Paths to follow: points over arc length, lane changes, tracks, speed profiles.

Start with `path.Path`.
"""
