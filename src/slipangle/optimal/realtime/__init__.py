"""The real-time solver: model code from CasADi, everything else our own C, compiled once per problem."""

from slipangle.optimal.realtime.backend import RealTime

__all__ = ["RealTime"]
