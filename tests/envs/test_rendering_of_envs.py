"""Pictures at any moment: before reset, after close, of copies, of several windows, of many robots."""

import copy
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from snake_env.envs import SnakeModeSelectionEnv, SnakeModeSelectionVectorEnv

MODES = ("rgb_array", "rgb_array_list", "human")


@pytest.fixture(autouse=True)
def _no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def _ended(mode: str) -> SnakeModeSelectionEnv:
    env = SnakeModeSelectionEnv(render_mode=mode, horizon=1)
    env.reset(seed=0)
    *_, terminated, truncated, _ = env.step(int(env.action_masks().argmax()))
    assert terminated or truncated
    return env


def _picture(env: SnakeModeSelectionEnv) -> Any:
    shown = env.render()
    if env.render_mode == "human":
        assert shown is None
        return shown
    frame = shown[-1] if isinstance(shown, list) else shown
    assert frame.shape == (480, 640, 3)
    return frame


@pytest.mark.parametrize("mode", MODES)
def test_render__before_the_first_reset_says_so(mode: str) -> None:
    for env in (
        SnakeModeSelectionEnv(render_mode=mode),
        copy.deepcopy(SnakeModeSelectionEnv(render_mode=mode)),
        gymnasium.make("snake_env:SnakeModeSelection-v0", render_mode=mode),
    ):
        with pytest.raises(ResetNeeded, match="reset"):
            env.render()


@pytest.mark.parametrize("mode", MODES)
def test_render__after_close_and_of_copies_shows_where_the_robot_is(mode: str) -> None:
    env = _ended(mode)
    _picture(env)
    twin = copy.deepcopy(env)
    again = _picture(twin)
    env.close()
    env.close()
    after = _picture(env)
    if mode != "human":
        assert np.array_equal(again, after)
    env.set_state(env.get_state())
    _picture(env)
    twin.close()
    env.close()


def test_windows__close_one_by_one() -> None:
    one, other = _ended("human"), _ended("human")
    one.close()
    other.reset(seed=1)
    other.step(int(other.action_masks().argmax()))
    one.reset(seed=2)  # opens again
    other.close()
    one.step(int(one.action_masks().argmax()))
    one.close()


def test_vector_env__shows_each_robot() -> None:
    envs = gymnasium.make_vec(
        "snake_env:SnakeModeSelection-v0", num_envs=3, render_mode="rgb_array"
    )
    with pytest.raises(ResetNeeded):
        envs.render()
    envs.reset(seed=0)
    first = envs.render()
    assert [frame.shape for frame in first] == [(480, 640, 3)] * 3
    envs.step(envs.unwrapped.action_masks().argmax(axis=1))
    assert not any(np.array_equal(a, b) for a, b in zip(first, envs.render(), strict=True))
    for copied in (copy.deepcopy(envs.unwrapped), pickle.loads(pickle.dumps(envs.unwrapped))):
        assert len(copied.render()) == 3
    assert SnakeModeSelectionVectorEnv(2).render() is None
