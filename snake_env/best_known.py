"""The shortest plans known for the frozen suites: what a perfect policy would have to beat."""

from __future__ import annotations

import csv
import functools
import importlib.resources
from dataclasses import dataclass

import numpy as np

from snake_env.errors import UnknownNameError
from snake_env.state import FloatArray


@dataclass(frozen=True, eq=False)
class BestKnown:
    """Plans for the tasks of a suite, for the preset ``paper``.

    Attributes:
        time_s: Durations, shape (N,) [s]; infinite where no plan is known.
        cost: Integrals of V, shape (N,) [s]; infinite where no plan is known.
        modes: Each plan's modes, or nothing.
        rollouts: Model roll-outs that were spent on each task, shape (N,).
    """

    time_s: FloatArray
    cost: FloatArray
    modes: tuple[tuple[int, ...], ...]
    rollouts: FloatArray


@functools.lru_cache(maxsize=4)
def best_known(suite: str) -> BestKnown:
    """The shortest plans known for a frozen suite, as ``python -m train solve`` found them.

    Raises:
        UnknownNameError: There are none for this suite.
    """
    folder = importlib.resources.files("snake_env") / "data" / "best_known"
    there = sorted(file.name.removesuffix(".csv") for file in folder.iterdir())
    if suite not in there:
        raise UnknownNameError("suite with best-known plans", suite, there)
    text = (folder / f"{suite}.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    return BestKnown(
        time_s=np.array([float(row["time_s"] or "inf") for row in rows]),
        cost=np.array([float(row["cost"] or "inf") for row in rows]),
        modes=tuple(tuple(map(int, row["modes"].split())) for row in rows),
        rollouts=np.array([float(row["rollouts"]) for row in rows]),
    )
