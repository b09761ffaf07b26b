"""What a recording is worth before anything is fitted to it.

Start with `inspect.inspect`; ``events`` finds spikes and jumps, ``delay`` how late an output follows an input,
``smooth`` takes noise and steps out of an input.
"""
