"""Test bed for identification: made cars that nobody tuned on, a competitor by hand, and planted mistakes."""
