"""Plain Stable-Baselines3: PPO on many robots at once, through ``snake_env.sb3.SnakeVecEnv``.

SB3's PPO knows no masks. With ``on_infeasible="reject"`` a forbidden choice costs time and a penalty
but does not end the episode, so it can learn by itself which modes to avoid:

    pip install snake-mode-env[train]
    python examples/sb3_ppo.py --steps 60000
"""

import argparse
import sys

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

from snake_env.sb3 import SnakeVecEnv

# The first simulation of the paper: a single task, so that learning shows within seconds.
TASK = {
    "task_suite": "sim-1",
    "horizon": 30,
    "on_infeasible": "reject",
    "reward_weights": {"violation": -1.0, "shaping": 1.0},
}


def mean_return(model: PPO, seed: int) -> float:
    """The mean return of 200 episodes; SnakeVecEnv counts them as Monitor would."""
    env = SnakeVecEnv(50, **TASK)
    env.seed(seed)
    returns, _ = evaluate_policy(model, env, n_eval_episodes=200, deterministic=False)
    return float(returns)


def main() -> None:
    """Learns, and fails unless the return rose."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=60_000, help="decisions to learn from")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)

    env = SnakeVecEnv(64, **TASK)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=32,
        batch_size=512,
        n_epochs=6,
        learning_rate=1e-3,
        ent_coef=0.01,
        seed=args.seed,
        device="cpu",
    )
    before = mean_return(model, seed=1000)
    model.learn(args.steps)
    after = mean_return(model, seed=1000)

    print(f"PPO, {model.num_timesteps} steps: mean return {before:.2f} -> {after:.2f}")
    if after < before + 0.5:
        sys.exit("the return did not rise")


if __name__ == "__main__":
    main()
