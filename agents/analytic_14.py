"""Chooses the candidates of the policy ``analytic-14``: ``python -m agents.analytic_14``.

The paper cut phase 1 from 99 to 14 modes by hand (Table II, which its text does not give). Ours are
chosen from data: in each phase, the 14 modes that (21) takes most often on training tasks.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import joblib
import tyro

from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import advance
from snake_env.sim.tasks import load_tasks
from snake_env.state import SnakeState


@dataclass(frozen=True)
class Options:
    """Count which modes (21) takes and keep the most frequent of each phase."""

    tasks: str = "random:2000:14"
    """Training tasks."""
    size: int = 14
    """Candidates to keep in each phase."""
    workers: int = -1
    """Processes; -1: one per core."""
    out: Path = Path("snake_env/policies/analytic_14.json")
    """File to write."""


def choices(state: SnakeState, params: SnakeParams) -> Counter[tuple[int, int]]:
    """How often (21) takes each (phase, mode) on the way from ``state``, to the end or the horizon."""
    optimizer = AnalyticOptimizer(params)
    counts: Counter[tuple[int, int]] = Counter()
    for _ in range(params.horizon):
        mode = None if state.done else optimizer.select(state).mode
        if mode is None:
            break
        counts[state.phase, mode] += 1
        state, _ = advance(state, mode, params)
    return counts


def main(options: Options) -> None:
    """Runs (21) on the training tasks and writes the table."""
    params = SnakeParams()
    suite = load_tasks(options.tasks, params)
    states = [suite.initial(task, params) for task in range(len(suite))]
    counted = joblib.Parallel(n_jobs=options.workers, verbose=1)(
        joblib.delayed(choices)(state, params) for state in states
    )
    counts: Counter[tuple[int, int]] = sum(counted, Counter())
    modes = {}
    for phase in range(1, params.n_joints + 1):
        valid = mode_table(params.n_joints).valid(phase).tolist()
        frequent = sorted(valid, key=lambda mode: (-counts[phase, mode], mode))[: options.size]
        kept, taken = sum(counts[phase, m] for m in frequent), sum(counts[phase, m] for m in valid)
        print(
            f"phase {phase}: {len(frequent)} of {len(valid)} modes, {kept / taken:.1%} of choices"
        )
        modes[str(phase)] = sorted(frequent)
    command = f"python -m agents.analytic_14 --tasks {options.tasks} --size {options.size}"
    options.out.write_text(json.dumps({"command": command, "modes": modes}) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
