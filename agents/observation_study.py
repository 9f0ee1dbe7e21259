"""Which rows of the observation help? ``python -m agents.observation_study``.

A small network learns from each set of rows to name the mode that (21) takes. Reported is how often it
does on tasks it has not seen, with the instant mask, mean and spread over seeds. Imitation is quick and
hardly noisy, so it tells sets of rows apart that reinforcement learning would need hours for.
"""

from __future__ import annotations

from dataclasses import dataclass

import joblib
import numpy as np
import torch
import tyro
from numpy.typing import NDArray

from snake_env.masks import action_masks
from snake_env.observation import observation_rows, observe
from snake_env.optimizer import AnalyticOptimizer
from snake_env.params import SnakeParams
from snake_env.simulation import advance
from snake_env.state import SnakeState, StateBatch
from snake_env.tasks import load_tasks

_MARKOV = (
    *("phi", "target", "phase", "ref_start", "cam_progress", "phase_time"),
    *("last_lifted", "last_turn", "head_error"),
)
ROW_SETS = {
    "the state alone": _MARKOV,
    "and errors, limit margins": (*_MARKOV, "error", "scp_error", "limit_margin"),
    "and link directions, places": (*_MARKOV, "link_direction", "link_centre"),
    "and gravity, support margins": (*_MARKOV, "centre_of_gravity", "support_margin"),
    "all rows": tuple(name for name, _ in observation_rows(8)),
}


@dataclass(frozen=True)
class Options:
    """Compare sets of the observation's rows."""

    tasks: int = 3000
    """Tasks to learn from; a fifth as many are kept for the test."""
    epochs: int = 30
    """Passes over the data."""
    seeds: int = 3
    """Networks for each set."""


def decisions(start: SnakeState, params: SnakeParams) -> tuple[list[SnakeState], list[int]]:
    """The states and modes of an episode under (21), without what follows on standing still."""
    optimizer = AnalyticOptimizer(params)
    states, modes, state = [], [], start
    while not state.done and len(states) < 30:
        mode = optimizer.select(state).last_resort
        states.append(state)
        modes.append(mode)
        state, _ = advance(state, mode, params)
    return states, modes


def collect(
    count: int, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.int64]]:
    """Observations, masks and modes of (21) on ``count`` tasks."""
    params = SnakeParams()
    suite = load_tasks(f"random:{count}:{seed}", params)
    episodes = joblib.Parallel(n_jobs=-1)(
        joblib.delayed(decisions)(suite.initial(task, params), params) for task in range(count)
    )
    states = StateBatch.stack([state for states, _ in episodes for state in states])
    modes = np.array([mode for _, modes in episodes for mode in modes])
    return observe(states, params), action_masks(states, "instant", params), modes


def columns(names: tuple[str, ...]) -> list[int]:
    """Positions of the named rows in the observation."""
    start, chosen = 0, []
    for name, size in observation_rows(8):
        chosen += list(range(start, start + size)) if name in names else []
        start += size
    return chosen


def agreement(train: tuple, test: tuple, chosen: list[int], epochs: int, seed: int) -> float:
    """Share of the test's decisions on which a network trained on these columns agrees with (21)."""
    torch.manual_seed(seed)
    x, mask, y = (torch.tensor(part) for part in train)
    x = x[:, chosen]
    network = torch.nn.Sequential(
        torch.nn.Linear(len(chosen), 256),
        torch.nn.ReLU(),
        torch.nn.Linear(256, 256),
        torch.nn.ReLU(),
        torch.nn.Linear(256, mask.shape[1]),
    )
    steps = epochs * (len(x) // 512)
    optimizer = torch.optim.AdamW(network.parameters(), 2e-3, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 2e-3, total_steps=steps)
    for _ in range(epochs):
        for batch in torch.randperm(len(x))[: len(x) // 512 * 512].reshape(-1, 512):
            logits = network(x[batch]).masked_fill(~mask[batch], -1e9)
            loss = torch.nn.functional.cross_entropy(logits, y[batch])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    x, mask, y = (torch.tensor(part) for part in test)
    with torch.no_grad():
        choice = network(x[:, chosen]).masked_fill(~mask, -1e9).argmax(dim=1)
    return float((choice == y).double().mean())


def main(options: Options) -> None:
    """Collects, trains and prints."""
    torch.set_num_threads(1)
    train = collect(options.tasks, 31)
    test = collect(max(1, options.tasks // 5), 32)
    print(f"{len(train[2])} decisions to learn from, {len(test[2])} to test on")
    for name, names in ROW_SETS.items():
        chosen = columns(names)
        shares = joblib.Parallel(n_jobs=-1)(
            joblib.delayed(agreement)(train, test, chosen, options.epochs, seed)
            for seed in range(options.seeds)
        )
        print(
            f"{name:30} {len(chosen):3d} values: agrees with (21) on "
            f"{np.mean(shares):.1%} +- {np.std(shares):.1%}",
            flush=True,
        )


if __name__ == "__main__":
    main(tyro.cli(Options, prog="python -m agents.observation_study", description=__doc__))
