"""What every model is, and all that are built in.

Start with `model.Model`, the contract: ``step`` and ``output`` on numbers and symbols. ``vehicles`` and ``tires`` are
physics, ``black_box`` are differences and networks, ``wrappers`` vary a model by another around it; ``ode`` takes
equations of your own, ``storage`` keeps any of them as readable text.
"""
