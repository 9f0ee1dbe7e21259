"""Tianshou: masked DQN on ``ActionMaskObservation(env, "tianshou")``.

Tianshou's discrete policies look for the mask in ``batch.obs.mask`` and for what the network sees in
``batch.obs.obs``, so the wrapper's observations are dicts with these keys:

    pip install snake-mode-env tianshou
    python examples/tianshou_dqn.py --steps 12000
"""

import argparse
import sys

import gymnasium
import numpy as np
import torch
from tianshou.algorithm import DQN
from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OffPolicyTrainerParams
from tianshou.utils.net.common import Net

from snake_env.envs import ActionMaskObservation

# The first simulation of the paper: a single task, so that learning shows within a minute.
TASK = {"task_suite": "sim-1", "horizon": 30}


def make() -> gymnasium.Env:
    """One robot, with its mask in the observation."""
    env = gymnasium.make("snake_env:SnakeModeSelection-v0", **TASK)
    return ActionMaskObservation(env, "tianshou")


def mean_return(algorithm: DQN, seed: int, eps: float) -> float:
    """The mean return of 64 episodes; a share ``eps`` of the choices is drawn from the mask."""
    algorithm.policy.set_eps_inference(eps)
    collector = Collector(algorithm, DummyVectorEnv([make] * 16), exploration_noise=True)
    collector.reset(gym_reset_kwargs={"seed": seed})
    return float(collector.collect(n_episode=64).returns.mean())


def main() -> None:
    """Learns, and fails unless the return rose."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=12_000, help="decisions to learn from")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    np.random.seed(args.seed)  # noqa: NPY002  # Tianshou explores with it

    single = make()
    size = single.observation_space["obs"].shape
    net = Net(state_shape=size, action_shape=single.action_space.n, hidden_sizes=[64, 64])
    policy = DiscreteQLearningPolicy(model=net, action_space=single.action_space, eps_training=0.2)
    algorithm = DQN(
        policy=policy,
        optim=AdamOptimizerFactory(lr=5e-4),
        gamma=0.99,
        n_step_return_horizon=3,
        target_update_freq=200,
    )
    before = mean_return(algorithm, seed=1000, eps=1.0)

    envs = DummyVectorEnv([make] * 16)
    envs.seed(args.seed)
    buffer = VectorReplayBuffer(50_000, buffer_num=16)
    collector = Collector(algorithm, envs, buffer, exploration_noise=True)
    algorithm.run_training(
        OffPolicyTrainerParams(
            training_collector=collector,
            max_epochs=1,
            epoch_num_steps=args.steps,
            collection_step_num_env_steps=64,
            update_step_num_gradient_steps_per_sample=0.25,
            batch_size=128,
            verbose=False,
            show_progress=False,
        )
    )
    after = mean_return(algorithm, seed=1000, eps=0.05)  # greedy, one task is a single sample

    print(f"masked DQN, {args.steps} steps: mean return {before:.2f} -> {after:.2f}")
    if after < before + 0.2:
        sys.exit("the return did not rise")


if __name__ == "__main__":
    main()
