"""A small evaluation for the tests: six tasks, their rows and summary."""

import functools
from pathlib import Path
from typing import Any

from evaluate.protocol import Row, Shard, run_shard
from evaluate.statistics import summarise
from snake_env.params import SnakeParams
from snake_env.sim.tasks import TaskSuite, random_suite
from tests.support.commands import read_csv
from tests.support.robots import PAPER

SUITE = random_suite(6, 3, PAPER)


def evaluated(policy: str, suite: TaskSuite, params: SnakeParams = PAPER, **more: Any) -> list[Row]:
    """A policy's episodes on a suite; more are attributes of their shard."""
    return run_shard(Shard.of(policy, suite, list(range(len(suite))), params, **more))


@functools.cache
def rows_of(policy: str) -> list[Row]:
    """A policy's episodes on the six tasks."""
    return evaluated(policy, SUITE)


def episodes(folder: Path) -> list[dict[str, str]]:
    """What an evaluation has written down."""
    return read_csv(folder / "episodes.csv")


def summary_of(
    rows: dict[str, list[Row]], params: SnakeParams = PAPER, **more: Any
) -> dict[str, Any]:
    """What ``summary.json`` says of some rows."""
    return {
        "policies": {
            name: summarise(own, [100.0, 2000.0] if own[0]["modes"] else [], params)
            for name, own in rows.items()
        },
        "tasks": {"name": "random:6:3", "n": len(next(iter(rows.values())))},
        "preset": "paper",
        "slip": [0.0, 0.0],
        "models": {name: [] for name in rows},
        "params": params.__dict__,
        "command": "python -m evaluate <here> & there",
        "versions": {"snake-mode-env": "0.1.0", "python": "3.11"},
        "machine": {"processor": "x86_64", "cores": 2},
        **more,
    }
