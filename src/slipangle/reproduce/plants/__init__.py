"""The thesis' small systems: pendulum, EMPS and its friction, Narendra's."""
