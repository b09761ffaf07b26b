"""The car with four wheels, roll and pitch, and its step in compiled C."""
