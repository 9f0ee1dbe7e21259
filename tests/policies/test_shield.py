"""Shield and critic over many tasks: whatever the policy behind them wants, nothing is violated."""

from collections import Counter

import pytest

from evaluate.protocol import Row, Shard, run_shard
from evaluate.statistics import VIOLATIONS
from harness.engine import Engine
from snake_env import SnakeParams
from snake_env.sim.tasks import load_tasks
from snake_env.sim.warm_up import warm_up

_PART = 250


def _played(policy: str, tasks: str, params: SnakeParams) -> list[list[Row]]:
    suite = load_tasks(tasks, params)
    warm_up(params)
    shards = [
        Shard.of(policy, suite, list(range(first, min(first + _PART, len(suite)))), params)
        for first in range(0, len(suite), _PART)
    ]
    return list(Engine().map(run_shard, shards))


@pytest.mark.slow
def test_shield__violates_nothing_on_10000_tasks() -> None:
    rows = [
        row for part in _played("imitate+shield", "random:10000:31", SnakeParams()) for row in part
    ]
    assert len(rows) == 10_000
    assert not [row for row in rows if row["outcome"] in (*VIOLATIONS, "error")]
    assert sum(row["outcome"] == "success" for row in rows) > 9_900


@pytest.mark.parametrize("preset", ["narrow", "six"])
def test_critic__violates_nothing(preset: str) -> None:
    """The committed results say the same of 10,000 tasks: see the tests of the benchmarks."""
    played = _played("ppo+critic", "random:300:33", SnakeParams.preset(preset))
    outcomes = Counter(row["outcome"] for part in played for row in part)
    assert outcomes.keys() <= {"success", "deadlock", "horizon"}
    assert outcomes["success"] > 200


@pytest.mark.parametrize("preset", ["paper", "narrow"])
def test_shield__makes_even_random_choices_safe(preset: str) -> None:
    params = SnakeParams.preset(preset)
    raw, shielded = (
        [row["outcome"] for part in _played(name, "random:60:32", params) for row in part]
        for name in ("random", "random+shield")
    )
    assert sum(outcome in VIOLATIONS for outcome in raw) > 10
    assert not [outcome for outcome in shielded if outcome in (*VIOLATIONS, "error")]
