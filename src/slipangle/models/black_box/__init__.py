"""Models from data alone: ARX and its kin, state space, NARX, neural state space, Lur'e."""
