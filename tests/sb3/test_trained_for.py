"""The robot and the reward of a model's env, through wrappers: what may change either is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import pytest
from gymnasium import wrappers
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    SubprocVecEnv,
    VecCheckNan,
    VecEnvWrapper,
    VecMonitor,
)

from snake_env import InvalidInputError, SnakeParams
from snake_env.envs import SnakeModeSelectionEnv
from snake_env.sb3 import SnakeVecEnv, write_sb3_model
from snake_env.sb3.trained_for import options_of

SIX = SnakeParams.preset("six")
ID = "snake_env:SnakeModeSelectionSix-v0"


def _single(wrap: Callable[[Any], Any] = lambda env: env) -> DummyVecEnv:
    return DummyVecEnv([lambda: wrap(gymnasium.make(ID))])


class OwnVecWrapper(VecEnvWrapper):
    """Somebody's own."""

    def reset(self) -> Any:
        return self.venv.reset()

    def step_wait(self) -> Any:
        return self.venv.step_wait()


class OwnWrapper(gymnasium.ObservationWrapper[Any, Any, Any]):
    """Somebody's own, which changes what is seen."""

    def observation(self, observation: Any) -> Any:
        return -observation


TRANSPARENT: dict[str, Callable[[], Any]] = {
    "none": _single,
    "statistics": lambda: _single(wrappers.RecordEpisodeStatistics),
    "time limit": lambda: _single(lambda env: wrappers.TimeLimit(env, 50)),
    "of the vector env": lambda: VecCheckNan(SnakeVecEnv(2, preset="six")),
    "of single envs": lambda: VecMonitor(_single()),
    "made by hand": lambda: DummyVecEnv([lambda: SnakeModeSelectionEnv("six")]),
}
OTHERS: dict[str, tuple[Callable[[], Any], str]] = {
    "NormalizeObservation": (lambda: _single(wrappers.NormalizeObservation), "observation"),
    "NormalizeReward": (lambda: _single(wrappers.NormalizeReward), "reward"),
    "TransformReward": (
        lambda: _single(lambda env: wrappers.TransformReward(env, lambda r: 100 * r)),
        "reward",
    ),
    "TransformAction": (
        lambda: _single(lambda env: wrappers.TransformAction(env, lambda a: a, env.action_space)),
        "action",
    ),
    "OwnWrapper": (lambda: _single(OwnWrapper), "observation"),
    "OwnVecWrapper": (lambda: OwnVecWrapper(SnakeVecEnv(2, preset="six")), "all"),
}


@pytest.mark.parametrize("case", TRANSPARENT)
def test_robot__is_seen_through_wrappers_that_change_nothing(case: str) -> None:
    options = options_of(TRANSPARENT[case]())
    assert options is not None
    assert options.params == SIX


@pytest.mark.parametrize("case", OTHERS)
def test_model_behind_other_wrappers__is_refused(case: str, tmp_path: Path) -> None:
    env = OTHERS[case][0]()
    model = PPO("MlpPolicy", env, n_steps=2, batch_size=2, device="cpu")
    file = tmp_path / "a.safetensors"
    with pytest.raises(InvalidInputError, match=f"env = '{case}': expected no wrapper that may"):
        write_sb3_model(model, file)
    assert not file.exists()
    model.save(tmp_path / "a.zip")
    without_env = PPO.load(tmp_path / "a.zip", device="cpu")
    assert write_sb3_model(without_env, file, SIX) == file  # its user knows better


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: wrappers.NormalizeReward(gymnasium.make(ID)), "NormalizeReward"),
        (lambda: wrappers.NormalizeReward(SnakeModeSelectionEnv("six")), "NormalizeReward"),
        (lambda: OwnWrapper(SnakeModeSelectionEnv("six")), "ObservationWrapper"),
    ],
)
def test_wrappers_in_other_processes__are_seen(make: Callable[[], Any], name: str) -> None:
    env = SubprocVecEnv([make], start_method="fork")
    try:
        with pytest.raises(InvalidInputError, match=f"env = '{name}'"):
            options_of(env)
    finally:
        env.close()


@pytest.mark.parametrize(
    ("more", "name"),
    [({"a_c": 1.0}, "a_c"), ({"reward_weights": {"time": -1.0}}, "reward_weights")],
)
def test_robots_that_differ__are_refused(more: dict[str, Any], name: str) -> None:
    env = DummyVecEnv(
        [lambda: SnakeModeSelectionEnv("six"), lambda: SnakeModeSelectionEnv("six", **more)]
    )
    with pytest.raises(InvalidInputError, match=f"robots that differ in {name}"):
        options_of(env)


def test_env_of_others__tells_nothing() -> None:
    assert options_of(None) is None
    assert options_of(DummyVecEnv([lambda: gymnasium.make("CartPole-v1")])) is None
