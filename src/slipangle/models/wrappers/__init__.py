"""Models around models: on the ground, late, corrected by a network, several as one."""
