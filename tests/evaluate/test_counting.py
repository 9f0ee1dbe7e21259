"""Roll-outs of policies of others: counted however they count, or an error of the episode."""

import pytest

from evaluate.protocol import Shard, run_shard
from evaluate.rows import pack
from snake_env.sim.tasks import random_suite
from tests.support.robots import PAPER

OTHERS = "tests.support.policies_of_others"
SUITE = random_suite(8, 3, PAPER)


def _shard(policy: str) -> Shard:
    tasks = list(range(len(SUITE)))
    return Shard(policy, tasks, [SUITE.initial(task, PAPER) for task in tasks], PAPER)


def test_policy_that_counts_each_episode_by_itself__is_counted_as_the_others() -> None:
    own, known = (run_shard(_shard(name)) for name in (f"{OTHERS}:PerEpisode", "analytic"))
    assert [row["rollouts"] for row in own] == [row["rollouts"] for row in known]
    assert len({row["rollouts"] for row in known}) > 3  # some fall from one to the next


@pytest.mark.parametrize("name", ["Countless", "CountingDown"])
def test_count_that_can_not_be__is_an_error_of_the_episode(name: str) -> None:
    rows = run_shard(_shard(f"{OTHERS}:{name}"))
    assert {row["outcome"] for row in rows} == {"error"}
    assert all(row["error"].startswith("InvalidInputError: rollouts = ") for row in rows)
    pack(rows)  # they can be kept
