"""From measurements to states and parameters, sample by sample."""
