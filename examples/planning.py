"""Planning without any learning library: look ahead with ``get_state`` and ``set_state``.

The paper's optimiser (21) compares what each mode does within the next 3 s. Here every mode that the
mask allows is tried in the env itself and the optimiser plays on to the end: what finishes first is
kept. Because the plan found so far is kept until a better one turns up, it can't do worse.

    pip install snake-mode-env
    python examples/planning.py --steps 5
"""

import argparse
import sys

import gymnasium
import numpy as np

from snake_env import AnalyticOptimizer

SUITE = "random:1000:1"


def play(env: gymnasium.Env, optimizer: AnalyticOptimizer, limit: int) -> list[int] | None:
    """The optimiser's modes from the env's state to the target, or None: it needs over ``limit``."""
    modes: list[int] = []
    while len(modes) < limit:
        mode = optimizer.select(env.unwrapped.state).mode
        if mode is None:  # a deadlock: no mode is feasible
            return None
        modes.append(mode)
        _, _, terminated, truncated, info = env.step(mode)
        if terminated or truncated:
            return modes if info["is_success"] else None
    return None


def plan(env: gymnasium.Env, optimizer: AnalyticOptimizer, best: list[int] | None) -> list[int]:
    """The best plan from here: the one known, or a mode of the mask and then the optimiser's."""
    here = env.unwrapped.get_state()
    shortest = env.unwrapped.params.horizon + 1 if best is None else len(best)
    for mode in np.flatnonzero(env.unwrapped.action_masks()).tolist():
        env.unwrapped.set_state(here)
        _, _, terminated, truncated, info = env.step(mode)
        if info["is_success"]:
            rest: list[int] | None = []
        elif terminated or truncated:
            rest = None
        else:
            rest = play(env, optimizer, limit=shortest - 2)
        if rest is not None and len(rest) + 1 < shortest:
            best, shortest = [mode, *rest], len(rest) + 1
    env.unwrapped.set_state(here)
    return best or []


def solve(env: gymnasium.Env, optimizer: AnalyticOptimizer, task: int) -> tuple[int, int]:
    """Intervals that the optimiser and the planner need for a task; the horizon is failure."""
    horizon = env.unwrapped.params.horizon
    env.reset(options={"task": task})
    start = env.unwrapped.get_state()
    best = play(env, optimizer, horizon)
    optimal = horizon if best is None else len(best)
    env.unwrapped.set_state(start)
    for step in range(horizon):
        best = plan(env, optimizer, best)
        if not best:
            break
        _, _, terminated, truncated, info = env.step(best.pop(0))
        if terminated or truncated:
            return optimal, step + 1 if info["is_success"] else horizon
    return optimal, horizon


def main() -> None:
    """Solves tasks both ways, and fails if planning was slower on any or faster on none."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=5, help="tasks to solve")
    parser.add_argument("--seed", type=int, default=0, help="first task of the suite")
    args = parser.parse_args()

    env = gymnasium.make("snake_env:SnakeModeSelection-v0", n_joints=7, task_suite=SUITE)
    delta_t = env.unwrapped.params.delta_t
    optimizer = AnalyticOptimizer(env.unwrapped.params)
    times = np.array([solve(env, optimizer, args.seed + k) for k in range(args.steps)]) * delta_t
    for task, (optimal, planned) in enumerate(times, start=args.seed):
        print(f"task {task}: optimiser {optimal:.0f} s, planner {planned:.0f} s")
    before, after = times.mean(axis=0)
    print(f"planning, {args.steps} tasks: mean time {before:.0f} s -> {after:.0f} s")
    if (times[:, 1] > times[:, 0]).any() or after >= before:
        sys.exit("the planner did not beat the optimiser")


if __name__ == "__main__":
    main()
