"""A linear state space bent by a few static curves, fitted to its free run."""
