"""Benchmarks: each module is a command, ``python -m benchmarks.kernel``, ``.vector``, ``.training``."""
