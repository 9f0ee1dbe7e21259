"""The scale of what is learned about a robot: how long its episodes are."""

import numpy as np
import pytest

from agents.failures import failure_cost, failure_value
from agents.imitate import action_values
from snake_env.envs.reward import RewardWeights
from snake_env.params import SnakeParams
from snake_env.sim.tasks import load_tasks
from tests.support.evaluations import evaluated
from tests.support.robots import PAPER


@pytest.mark.parametrize("preset", ["paper", "hardware", "six"])
def test_failure__is_twice_what_the_optimiser_needs(preset: str) -> None:
    params = SnakeParams.preset(preset)
    suite = load_tasks("random:32:1", params)
    rows = evaluated("analytic", suite, params)
    needed = [row["intervals"] for row in rows if row["outcome"] == "success"]
    assert failure_cost(params) == max(30.0, 2.0 * np.median(needed))


def test_failure__is_more_for_a_slower_robot() -> None:
    slow = SnakeParams.preset("hardware")
    assert failure_cost(PAPER) == 30.0
    assert 45.0 < failure_cost(slow) < 60.0
    assert failure_cost(PAPER.replace(horizon=2)) == 30.0  # no task is solved
    reward = RewardWeights()
    assert failure_value(PAPER, reward) == pytest.approx(1.0 - 0.1 * 40.0)
    assert failure_value(slow, reward) == pytest.approx(1.0 - 0.1 * (failure_cost(slow) + 10.0))


def test_action_values__of_all_that_succeeds_lie_above_what_fails() -> None:
    import torch

    for preset in ("paper", "hardware"):
        params = SnakeParams.preset(preset)
        least = failure_value(params, RewardWeights())
        costs = torch.tensor([[1.0, failure_cost(params), 1.0 + failure_cost(params), torch.inf]])
        (values,) = action_values(costs, least).tolist()
        assert values == sorted(values, reverse=True)
        assert values[-1] == pytest.approx(least)
        assert values[-2] > values[-1] + 0.5
