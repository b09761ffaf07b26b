"""From data to models: each estimator is frozen settings whose ``fit`` returns a new model.

``linear`` for ARX to state space, ``lure`` for one bent by static curves, ``physics`` for parameters of equations,
``networks``, ``tires``; ``search`` chooses settings; ``judge`` has the verdict, on data that no fit saw.
"""
