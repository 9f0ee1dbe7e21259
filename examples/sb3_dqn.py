"""Plain Stable-Baselines3: DQN, which finds the mask in the observation.

SB3's DQN knows no masks either. ``mask_in_observation`` shows it the mask beside the observation, and
``on_infeasible="reject"`` lets it try what is forbidden at the price of some time. (For a single env,
``snake_env.envs.ActionMaskObservation(env, "sb3")`` gives the same observations.)

    pip install snake-mode-env[train]
    python examples/sb3_dqn.py --steps 60000
"""

import argparse
import sys

import numpy as np
import torch
from stable_baselines3 import DQN
from stable_baselines3.common.evaluation import evaluate_policy

from snake_env.sb3 import SnakeVecEnv

# The first simulation of the paper: a single task, so that learning shows within seconds.
TASK = {
    "mask_in_observation": True,
    "task_suite": "sim-1",
    "horizon": 30,
    "on_infeasible": "reject",
    "reward_weights": {"violation": -0.2, "shaping": 1.0},
}


def random_return(model: DQN, seed: int) -> float:
    """The mean return of 200 episodes in which every choice is drawn at random."""
    env = SnakeVecEnv(50, **TASK)
    env.seed(seed)
    model.exploration_rate = 1.0
    returns, _ = evaluate_policy(model, env, n_eval_episodes=200, deterministic=False)
    return float(returns)


def main() -> None:
    """Learns, and fails unless the return rose."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=60_000, help="decisions to learn from")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)

    env = SnakeVecEnv(16, **TASK)
    model = DQN(
        "MultiInputPolicy",
        env,
        learning_rate=1e-3,
        buffer_size=50_000,
        learning_starts=1_000,
        batch_size=128,
        train_freq=4,  # after every 4 steps of the 16 robots
        gradient_steps=16,
        target_update_interval=1_000,
        exploration_fraction=0.5,
        seed=args.seed,
        device="cpu",
    )
    before = random_return(model, seed=1000)
    model.learn(args.steps)
    # The greedy policy on one task is a single sample: take the last 100 episodes of the training.
    after = float(np.mean([episode["r"] for episode in model.ep_info_buffer]))

    print(f"DQN, {model.num_timesteps} steps: mean return {before:.2f} -> {after:.2f}")
    if after < before + 0.5:
        sys.exit("the return did not rise")


if __name__ == "__main__":
    main()
