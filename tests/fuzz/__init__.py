"""Fuzzing of everything that reads a file: damaged and hostile input ends in one sentence or in a result.

`targets` says what is tried and makes the inputs, `mutate` damages them, `runner` tries them in a process of its own,
whose memory and processor time per input are limited. A run is a target, a seed and a number of inputs, and every input
can be made again from these:

    python -m tests.fuzz --seconds 3600 --seed 7
    python -m tests.fuzz --target csv --seed 7 --index 123
"""
