"""What a failure costs: the scale of what is learned about a robot is the length of its episodes."""

from __future__ import annotations

import functools

import numpy as np

from snake_env.envs.reward import RewardWeights
from snake_env.params import SnakeParams
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import advance
from snake_env.sim.tasks import random_suite

_LEAST = 30.0
_TASKS, _SEED = 32, 1
_BEYOND = 10.0  # intervals by which failures are worth less than all successes


@functools.lru_cache(maxsize=8)
def failure_cost(params: SnakeParams) -> float:
    """Cost of a state from which the target is not reached [intervals].

    Twice what the paper's optimiser, its equation (21), needs for some random tasks, in the median,
    and at least 30. So nearly all successes take less, and failures do not cost so much that nothing
    else counts.
    """
    suite = random_suite(_TASKS, _SEED, params)
    optimizer = AnalyticOptimizer(params)
    needed = []
    for task in range(_TASKS):
        state = suite.initial(task, params)
        for _ in range(params.horizon):
            selection = optimizer.select(state)
            state, prediction = advance(state, selection.last_resort, params)
            if state.done or not prediction.feasible[0]:
                break
        if state.done:
            needed.append(round(state.elapsed / params.delta_t))
    return max(_LEAST, 2.0 * float(np.median(needed))) if needed else _LEAST


def failure_value(params: SnakeParams, reward: RewardWeights) -> float:
    """Action value of what fails, below all others.

    Not as far as the return of a failure, which would cost the others their resolution.

    Args:
        params: The robot.
        reward: In whose units.
    """
    return reward.success + reward.time * (failure_cost(params) + _BEYOND)
