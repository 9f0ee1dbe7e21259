"""The adapter of examples/ that evaluates a model of Stable-Baselines3."""

from __future__ import annotations

from pathlib import Path

import pytest
from stable_baselines3 import PPO

from examples.sb3_model import SavedModel
from snake_env import SnakeParams, action_mask, advance, load_tasks
from snake_env.sb3 import MaskedActorCriticPolicy, SnakeVecEnv


def saved(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A model that has learned nothing yet."""
    env = SnakeVecEnv(8, mask_in_observation=True)
    model = PPO(MaskedActorCriticPolicy, env, n_steps=8, batch_size=64, seed=0, device="cpu")
    model.save(folder / "my_ppo.zip")
    monkeypatch.setenv("SB3_MODEL", str(folder / "my_ppo.zip"))


def test_saved_model__never_repeats_a_mode_that_did_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved(tmp_path, monkeypatch)
    params = SnakeParams()
    policy, suite = SavedModel(params), load_tasks("paper-500", params)
    policy.reset(0)
    state = suite.initial(0, params)
    first = policy.select_mode(state)
    tried = [first]
    for k in range(1, 6):  # intervals in which the robot stands still
        state = state.replace(last_mode=tried[-1], elapsed=3.0 * k)
        tried.append(policy.select_mode(state))
    assert len(set(tried)) == len(tried)
    assert all(action_mask(state, params)[tried])
    policy.reset(1)
    assert policy.select_mode(suite.initial(0, params)) == first
    assert policy.rollouts == 0


def test_saved_model__plays_an_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved(tmp_path, monkeypatch)
    params = SnakeParams()
    policy, state = SavedModel(params), load_tasks("sim-1", params).initial(0, params)
    for _ in range(10):
        state, prediction = advance(state, policy.select_mode(state), params)
        if not prediction.feasible[0]:
            break
    assert state.elapsed > 0
