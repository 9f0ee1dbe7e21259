"""Ray RLlib: PPO with its action-masking module on ``ActionMaskObservation(env, "rllib")``.

The module finds ``observations`` and ``action_mask`` (of float32) in the wrapper's observations:

    pip install snake-mode-env torch "ray[rllib]"
    python examples/rllib_ppo.py --steps 30000
"""

import argparse
import sys
from typing import Any

import gymnasium
import ray
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.examples.rl_modules.classes.action_masking_rlm import ActionMaskingTorchRLModule
from ray.tune.registry import register_env

from snake_env.envs import ActionMaskObservation

# The first simulation of the paper: a single task, so that learning shows within a minute.
TASK = {"task_suite": "sim-1"}
STEPS = 2048  # decisions between two updates


def make(config: dict[str, Any]) -> gymnasium.Env:
    """One robot, with its mask in the observation."""
    env = gymnasium.make("snake_env:SnakeModeSelection-v0", **config)
    return ActionMaskObservation(env, "rllib")


def main() -> None:
    """Learns, and fails unless the return rose."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=30_000, help="decisions to learn from")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)

    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False, logging_level="error")
    register_env("snake", make)
    config = (
        PPOConfig()
        .environment("snake", env_config=TASK)
        .env_runners(num_env_runners=0, num_envs_per_env_runner=16)  # in this process
        .learners(num_learners=0)
        .rl_module(
            rl_module_spec=RLModuleSpec(
                module_class=ActionMaskingTorchRLModule,
                model_config={"fcnet_hiddens": [64, 64], "fcnet_activation": "tanh"},
            )
        )
        .training(
            train_batch_size_per_learner=STEPS,
            minibatch_size=256,
            num_epochs=6,
            lr=1e-3,
            gamma=0.99,
            lambda_=0.95,
            entropy_coeff=0.01,
        )
        .debugging(seed=args.seed, log_level="ERROR")
    )
    algorithm = config.build_algo()
    returns = []  # the mean of the latest 100 episodes, after each update
    for _ in range(max(2, args.steps // STEPS)):
        returns.append(algorithm.train()["env_runners"]["episode_return_mean"])
    algorithm.stop()
    ray.shutdown()

    before, after = returns[0], returns[-1]
    print(f"masked PPO, {len(returns) * STEPS} steps: mean return {before:.2f} -> {after:.2f}")
    if after < before + 0.2:
        sys.exit("the return did not rise")


if __name__ == "__main__":
    main()
