"""The reward: success first, then time; a failure costs the same however and whenever it comes."""

from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from snake_env import Policy, load_policy
from snake_env.envs import SnakeModeSelectionEnv
from snake_env.envs.reward import RewardWeights
from snake_env.sim.masks import action_masks
from snake_env.sim.tasks import load_tasks

NARROW_TASKS = 150


def _return(policy: Policy, env: SnakeModeSelectionEnv, task: int) -> tuple[float, str, int]:
    """Return, outcome and decisions of an episode."""
    env.reset(seed=task, options={"task": task})
    policy.reset(task)
    total, over, info = 0.0, False, {}
    while not over:
        _, reward, terminated, truncated, info = env.step(policy.select_mode(env.state))
        total += reward
        over = terminated or truncated
    summary = info["episode_summary"]
    return total, summary["outcome"], summary["intervals"]


def test_return__is_known_from_outcome_and_time() -> None:
    env = SnakeModeSelectionEnv(preset="narrow", task_suite="random:60:3")
    seen = set()
    for name in ("analytic", "random", "ppo"):
        policy = load_policy(name, env.params)
        for task in range(25):
            total, outcome, intervals = _return(policy, env, task)
            expected = 1.0 - 0.1 * intervals if outcome == "success" else -30.0
            assert total == pytest.approx(expected)
            seen.add(outcome)
    assert {"success", "stability"} <= seen


@pytest.mark.parametrize("wait", [0, 1, 40, 99])
def test_failure__costs_the_same_however_early_it_is_chosen(wait: int) -> None:
    env = SnakeModeSelectionEnv(on_infeasible="reject", task_suite="sim-1")
    env.reset(seed=0)
    total, over = 0.0, False
    for k in range(100):
        forbidden = _forbidden(env)
        if k == wait:  # from here on infeasible choices end the episode
            env = _terminating(env)
        _, reward, terminated, truncated, _ = env.step(forbidden)
        total += reward
        over = terminated or truncated
        if over:
            break
    assert over
    assert total == pytest.approx(-30.0)


def _forbidden(env: SnakeModeSelectionEnv) -> int:
    """A mode that the phase does not allow, or that breaks (22) or (23)."""
    allowed = action_masks(env.core.states, env.params, "lookahead")[0]
    return int(np.flatnonzero(~allowed)[0])


def _terminating(env: SnakeModeSelectionEnv) -> SnakeModeSelectionEnv:
    other = SnakeModeSelectionEnv(task_suite="sim-1")
    other.reset(seed=0)
    other.set_state(env.get_state())
    return other


def test_mean_return__ranks_the_optimiser_above_its_reduced_version() -> None:
    env = SnakeModeSelectionEnv(preset="narrow", task_suite=f"random:{NARROW_TASKS}:5")
    suite = load_tasks(f"random:{NARROW_TASKS}:5", env.params)
    figures = {}
    for name in ("analytic", "analytic-14"):
        policy = load_policy(name, env.params)
        episodes = [_return(policy, env, task) for task in range(len(suite))]
        success = np.mean([outcome == "success" for _, outcome, _ in episodes])
        figures[name] = float(np.mean([total for total, _, _ in episodes])), float(success)
    assert figures["analytic"][1] > figures["analytic-14"][1]
    assert figures["analytic"][0] > figures["analytic-14"][0]


@pytest.mark.parametrize("on_infeasible", ["reject", "terminate"])
def test_violation_and_cost__are_there_for_those_who_want_them(on_infeasible: str) -> None:
    weights = {"violation": -2.0, "cost": -0.5, "time": 0.0, "failure": 0.0}
    env = SnakeModeSelectionEnv(on_infeasible=on_infeasible, reward_weights=weights)
    env.reset(seed=0)
    *_, info = env.step(int(env.action_masks().argmax()))
    assert info["reward_terms"]["violation"] == 0.0
    assert -5.0 <= info["reward_terms"]["cost"] < 0.0
    *_, info = env.step(_forbidden(env))
    assert info["reward_terms"]["violation"] == -2.0


def test_weights__put_every_success_above_every_failure() -> None:
    weights, horizon = RewardWeights(), 100
    slowest = weights.success + weights.time * horizon
    failure = weights.time * horizon + weights.failure
    assert slowest == pytest.approx(-9.0)
    assert failure == pytest.approx(-30.0)


@pytest.mark.parametrize("kind", [Decimal, Fraction, np.float32])
def test_weights__may_be_any_real_numbers(kind: Any) -> None:
    """They are turned into floats, which all others are."""
    rewards = []
    for weight in (kind("-0.125"), -0.125):
        env = SnakeModeSelectionEnv(reward_weights={"time": weight})
        env.reset(seed=0)
        rewards.append(env.step(0)[1])
    assert rewards[0] == rewards[1]
