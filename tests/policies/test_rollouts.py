"""What policies say that they spent is what the kernel simulated, lane by lane."""

from collections.abc import Iterator

import numpy as np
import pytest

from snake_env import SnakeParams, SnakeState, load_policy
from snake_env.kernel.blocks import BlockProgram
from snake_env.kernel.interval import PADDING, Kernel
from snake_env.sim.simulation import advance
from snake_env.sim.tasks import load_tasks
from tests.support.robots import NARROW, random_state

POLICIES = (
    *("analytic", "analytic-14", "first-feasible", "random", "value", "lookahead:width=4"),
    *("lookahead:width=16,depth=2", "ppo", "dqn", "imitate"),
    *("ppo+shield", "dqn+shield", "imitate+shield", "random+shield", "value+shield"),
    *("ppo+critic", "dqn+critic:k=4", "imitate+critic:k=2"),
)


class _Count:
    """Counts the lanes that are taken through an interval."""

    lanes = 0


@pytest.fixture
def count(monkeypatch: pytest.MonkeyPatch) -> Iterator[_Count]:
    counted, run = _Count(), BlockProgram.run

    def counting(self: BlockProgram, blocks: np.ndarray, *others: np.ndarray) -> None:
        if isinstance(self, Kernel) and len(others[-1]) > 0:
            counted.lanes += int((blocks[:, self.rows["violation"].start] != PADDING).sum())
        run(self, blocks, *others)

    monkeypatch.setattr(BlockProgram, "run", counting)
    return counted


def _deadlocks() -> list[SnakeState]:
    """States of the narrow robot, a phase of which allows no feasible mode among them."""
    return [random_state(1, NARROW, 7), random_state(8, NARROW, 1), random_state(3, NARROW, 6)]


@pytest.mark.parametrize("name", POLICIES)
def test_rollouts__are_the_lanes_that_were_simulated(name: str, count: _Count) -> None:
    for params in (SnakeParams(), NARROW):
        if params is NARROW and name.startswith("imitate"):
            continue  # ships for one robot
        policy, suite = load_policy(name, params), load_tasks("random:3:8", params)
        starts = [suite.initial(task, params) for task in range(len(suite))]
        for start in [*starts, *(_deadlocks() if params is NARROW else [])]:
            policy.reset(0)
            state = start
            for _ in range(4):
                before = policy.rollouts
                count.lanes = 0
                mode = policy.select_mode(state)
                assert policy.rollouts - before == count.lanes
                state, _ = advance(state, mode, params)
                if state.done:
                    break


@pytest.mark.parametrize("name", [name for name in POLICIES if not name.startswith("imitate")])
def test_deadlock__is_counted_too(name: str, count: _Count) -> None:
    policy = load_policy(name, NARROW)
    policy.select_mode(_deadlocks()[0])
    assert policy.rollouts == count.lanes
