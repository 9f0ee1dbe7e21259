"""sb3-contrib: MaskablePPO on many robots at once, through ``snake_env.sb3.SnakeVecEnv``.

It asks the vector env for ``action_masks()`` by itself:

    pip install snake-mode-env[train] sb3-contrib
    python examples/sb3_contrib_maskable_ppo.py --steps 60000
"""

import argparse
import sys

import torch
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.evaluation import evaluate_policy

from snake_env.sb3 import SnakeVecEnv

# The first simulation of the paper: a single task, so that learning shows within seconds.
TASK = {"task_suite": "sim-1"}


def mean_return(model: MaskablePPO, seed: int) -> float:
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
    model = MaskablePPO(
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

    print(f"MaskablePPO, {model.num_timesteps} steps: mean return {before:.2f} -> {after:.2f}")
    if after < before + 0.2:
        sys.exit("the return did not rise")


if __name__ == "__main__":
    main()
