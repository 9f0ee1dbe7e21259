"""Speed of training: ``python -m benchmarks.training``.

PPO learns for a while in the real environment and in one that costs nothing and returns the same
arrays again and again: the learner's ceiling. They take turns, so that a noisy machine slows both.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import CallbackList

from agents.ppo import PPOLearner, Settings
from harness.options import parse
from snake_env.params import SnakeParams
from snake_env.sb3 import SnakeVecEnv
from snake_env.sim.warm_up import warm_up
from snake_env.system.exit_code import exit_code


@dataclass(frozen=True)
class Options:
    """Measure PPO's frames per second against a zero-cost environment."""

    rounds: int = 4
    """Iterations (a rollout and an update each) of either environment; they alternate."""


class _Free(SnakeVecEnv):
    """Costs nothing: every step returns what the first reset did."""

    def reset(self) -> Any:
        self._first = super().reset()
        self._never = np.zeros(self.num_envs, dtype=np.bool_)
        self._nothing: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return self._first

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        rewards = np.zeros(self.num_envs, dtype=np.float32)
        return self._first, rewards, self._never.copy(), self._nothing


def main(args: list[str] | None = None) -> int:
    """Measures and prints; the exit code."""
    options = parse(Options, "python -m benchmarks.training", args)
    torch.set_num_threads(1)
    warm_up(SnakeParams())
    settings = Settings()
    seconds = {"snake_env": 0.0, "zero-cost env": 0.0}
    learners = []
    for env_class in (SnakeVecEnv, _Free):
        env = env_class(settings.num_envs, mask_in_observation=True)
        learners.append(PPOLearner(settings, env, seed=0, device="cpu"))
    frames = settings.num_envs * settings.n_steps
    for round_ in range(options.rounds + 1):
        for name, learner in zip(seconds, learners, strict=True):
            began = time.perf_counter()
            learner.learn(frames * (round_ + 1), round_, CallbackList([]), lambda *_: None)
            if round_ > 0:  # the first one warms up
                seconds[name] += time.perf_counter() - began
    print(f"PPO, {settings.num_envs} robots, hidden {settings.hidden}, one torch thread")
    for name, spent in seconds.items():
        print(f"{name:14} {options.rounds * frames / spent:8.0f} frames/s")
    share = seconds["zero-cost env"] / seconds["snake_env"]
    print(f"{share:.0%} of the learner's ceiling")
    return 0


if __name__ == "__main__":
    sys.exit(exit_code(main))
