"""What a model of Stable-Baselines3 was trained for: the robot and the reward of its env."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecEnvWrapper

from snake_env.envs.core import EnvCore, EnvOptions
from snake_env.errors import InvalidInputError
from snake_env.sb3.vec_env import SnakeVecEnv

_TRANSPARENT = {
    "gymnasium": {
        *("Autoreset", "HumanRendering", "OrderEnforcing", "PassiveEnvChecker"),
        *("RecordEpisodeStatistics", "RecordVideo", "RenderCollection", "TimeLimit"),
    },
    "stable_baselines3": {"Monitor", "VecCheckNan", "VecMonitor", "VecVideoRecorder"},
    "sb3_contrib": {"ActionMasker"},
    "snake_env": {"ActionMaskObservation", "RecordMotion"},
}
"""Wrappers, by package, that leave observations, actions and rewards as they are."""
_CHANGING: tuple[type[gymnasium.Wrapper[Any, Any, Any, Any]], ...] = (
    *(gymnasium.ObservationWrapper, gymnasium.ActionWrapper, gymnasium.RewardWrapper),
    *(gymnasium.wrappers.NormalizeObservation, gymnasium.wrappers.NormalizeReward),
)


def options_of(env: VecEnv | None) -> EnvOptions | None:
    """The arguments that all of an env's robots have; None if it is not an env of this package.

    Raises:
        InvalidInputError: A wrapper may change observations, actions or rewards; or the robots or
            their rewards differ.
    """
    if env is None:
        return None
    inner = env.unwrapped
    try:
        cores: list[Any] = (
            [inner.envs.core] if isinstance(inner, SnakeVecEnv) else env.get_attr("core")
        )
    except AttributeError:
        return None
    options = [core.options for core in cores if isinstance(core, EnvCore)]
    if not options:
        return None
    for package, name in _wrappers(env):
        if name not in _TRANSPARENT.get(package, ()):
            expected = (
                "no wrapper that may change observations, actions or rewards (if it does not, load "
                "the model without its env, and pass params)"
            )
            raise InvalidInputError("env", name, expected)
    for other in options[1:]:
        different = list(options[0].params.differences(other.params))
        if other.weights != options[0].weights:
            different.append("reward_weights")
        if different:
            expected = "the same robot and reward in all of them"
            raise InvalidInputError(
                "env", f"robots that differ in {', '.join(different)}", expected
            )
    return options[0]


def _wrappers(env: VecEnv) -> Iterator[tuple[str, str]]:
    """The package and the name of each wrapper, of the vector env and in it."""
    while isinstance(env, VecEnvWrapper):
        yield _package(type(env).__module__), type(env).__name__
        env = env.venv
    if isinstance(env, DummyVecEnv):
        for single in env.envs:
            while isinstance(single, gymnasium.Wrapper):
                yield _package(type(single).__module__), type(single).__name__
                single = single.env
    elif not isinstance(env, SnakeVecEnv):  # other processes: they tell specs, and answer questions
        for spec in env.get_attr("spec"):
            for wrapper in getattr(spec, "additional_wrappers", ()):
                yield _package(wrapper.entry_point), wrapper.entry_point.rpartition(":")[2]
        for kind in _CHANGING:
            if any(env.env_is_wrapped(kind)):
                yield "gymnasium", kind.__name__


def _package(module: str) -> str:
    return module.partition(".")[0]
