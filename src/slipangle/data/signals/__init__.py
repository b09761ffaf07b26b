"""Signals that excite a vehicle or a model."""
