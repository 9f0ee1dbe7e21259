"""Masks in the observation, and videos that show the motion."""

import itertools
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo

from snake_env import InvalidInputError, UnknownNameError
from snake_env.envs.wrappers import MASK_FORMATS, ActionMaskObservation, RecordMotion

ID = "snake_env:SnakeModeSelection-v0"


@pytest.mark.parametrize("library", MASK_FORMATS)
def test_observation__holds_the_mask_of_now(library: str) -> None:
    env = ActionMaskObservation(gymnasium.make(ID), library)
    layout = MASK_FORMATS[library]
    observation, info = env.reset(seed=0)
    for _ in range(4):
        assert env.observation_space.contains(observation)
        assert observation[layout.mask].dtype == layout.dtype
        assert np.array_equal(observation[layout.mask].astype(np.int8), info["action_mask"])
        action = int(np.flatnonzero(info["action_mask"])[0])
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            break


def test_pettingzoo_style__env_masks_sample_only_valid_modes() -> None:
    env = ActionMaskObservation(gymnasium.make(ID), "pettingzoo")
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        env.action_space.seed(seed)
        for _ in range(6):
            action = env.action_space.sample(mask=observation["action_mask"])
            observation, _, terminated, truncated, info = env.step(action)
            assert info["violation"] != "invalid_mode"
            if terminated or truncated:
                break


@pytest.mark.parametrize(("library", "kept"), [("tianshou", False), ("sb3", True)])
def test_summary__is_left_out_where_a_library_can_not_take_it(library: str, kept: bool) -> None:
    env = ActionMaskObservation(gymnasium.make(ID, horizon=1), library)
    env.reset(seed=0)
    *_, terminated, truncated, info = env.step(0)
    assert terminated or truncated
    assert ("episode_summary" in info) == kept


def test_spec__keeps_the_wrapper() -> None:
    env = ActionMaskObservation(gymnasium.make(ID), "tianshou")
    again = gymnasium.make(env.spec)
    assert isinstance(again, ActionMaskObservation)
    assert again.format == env.format


def test_unknown_library__is_named() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'rllib'"):
        ActionMaskObservation(gymnasium.make(ID), "rlib")


def test_record_motion__keeps_every_frame(tmp_path: Path) -> None:
    env = RecordMotion(
        gymnasium.make(ID, render_mode="rgb_array_list"), str(tmp_path), lambda _: True
    )
    env.reset(seed=0)
    env.step(0)
    frames = list(env.recorded_frames)
    env.close()
    assert len(frames) > 10
    changed = [not np.array_equal(a, b) for a, b in itertools.pairwise(frames)]
    assert np.mean(changed) > 0.9
    assert [path.stat().st_size > 1000 for path in tmp_path.glob("*.mp4")] == [True]


def test_gymnasiums_record_video__works(tmp_path: Path) -> None:
    env = RecordVideo(gymnasium.make(ID, render_mode="rgb_array"), str(tmp_path), lambda _: True)
    env.reset(seed=0)
    env.step(0)
    env.close()
    assert len(list(tmp_path.glob("*.mp4"))) == 1


def test_other_envs__are_refused() -> None:
    with pytest.raises(InvalidInputError, match="env = 'CartPoleEnv': expected an env with"):
        ActionMaskObservation(gymnasium.make("CartPole-v1"))
    env = gymnasium.make("snake_env:SnakeModeSelection-v0", render_mode="rgb_array")
    with pytest.raises(
        InvalidInputError, match="render_mode = 'rgb_array': expected 'rgb_array_list'"
    ):
        RecordMotion(env, "videos")
