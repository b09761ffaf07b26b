"""Lags, layers, neurons and other settings by trial, on processes here or a cluster."""
