"""Which options of imitation help? ``python -m agents.imitation_study --lessons RUN``.

Networks learn from the same judgements of a run of ``train imitate`` and are asked about others that
none has seen: how often is the preferred mode infeasible, and what does it cost more than the best?
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from agents.imitate import Fit, Lessons, fit, read_lessons
from snake_env.network import Network
from snake_env.observation import observation_size


@dataclass(frozen=True)
class Options:
    """Compare options of imitation on held-out judgements."""

    lessons: Annotated[Path, tyro.conf.arg(metavar="RUN")] = Path("runs/imitate-paper-s0")
    """Folder of a run of train imitate."""
    decisions: int = 500_000
    """Judgements to learn from; a tenth of so many more are held out."""
    seeds: int = 2
    """Networks for each choice of options."""


CHOICES: dict[str, list[dict[str, object]]] = {
    "as it ships": [{}],
    "hidden layers": [{"hidden": h} for h in ((384, 384), (384, 384, 384), (640, 640, 320))],
    "regret of a violation": [{"violation": v} for v in (30.0, 300.0)],
    "cross-entropy": [{"cross_entropy": w} for w in (0.1, 1.0)],
    "values": [{"values": w} for w in (0.0, 100.0)],
    "batch": [{"batch_size": b} for b in (256, 2048)],
    "learning rate": [{"learning_rate": r} for r in (5e-4, 2e-3)],
}
"""What is compared: one option after the other is changed."""


def held_out(network: Network, lessons: Lessons) -> tuple[float, float]:
    """Share of infeasible preferences [%], and mean regret of the others [intervals]."""
    cost = lessons.cost.astype(np.float64)
    preferred = np.where(cost >= 0.0, network(lessons.observations), -np.inf).argmax(axis=1)
    taken = cost[np.arange(len(cost)), preferred]
    best = np.where(cost >= 0.0, cost, np.inf).min(axis=1)
    feasible = np.isfinite(taken)
    return 100.0 * float(1.0 - feasible.mean()), float((taken - best)[feasible].mean())


def split(run: Path, decisions: int, seed: int = 0) -> tuple[Lessons, Lessons]:
    """Judgements to learn from, and others."""
    lessons = read_lessons(run)
    observations = np.concatenate([part.observations for part in lessons])
    cost = np.concatenate([part.cost for part in lessons])
    order = np.random.default_rng(seed).permutation(len(cost))
    cut = min(decisions, int(len(order) / 1.1))
    parts = order[:cut], order[cut : cut + math.ceil(cut / 10)]
    learned, other = (Lessons(observations[part], cost[part]) for part in parts)
    return learned, other


def main(options: Options) -> None:
    """Learns, asks and prints."""
    torch.set_num_threads(1)
    console = Console(width=100)
    learned, other = split(options.lessons, options.decisions)
    n_joints = next(n for n in range(5, 17) if observation_size(n) == learned.observations.shape[1])
    console.print(f"{len(learned.cost)} judgements to learn from, {len(other.cost)} held out")
    table = Table(box=None)
    for column in ("option", "value", "infeasible [%]", "regret of the others [intervals]"):
        table.add_column(column, justify="right" if "[" in column else "left")
    for name, change in [(n, c) for n, changes in CHOICES.items() for c in changes]:
        how = dataclasses.replace(Fit(), **change)
        networks = [
            fit(None, [learned], how, n_joints, seed, last=True)[0] for seed in range(options.seeds)
        ]
        figures = np.array([held_out(network, other) for network in networks])
        spread = np.ptp(figures, axis=0) / 2.0
        value = ", ".join(str(v) for v in change.values()) or "-"
        shown = [f"{m:.3f} +- {s:.3f}" for m, s in zip(figures.mean(axis=0), spread, strict=True)]
        table.add_row(name, value, *shown)
        console.print(f"{name} {value}: {', '.join(shown)}")
    console.print(table)


if __name__ == "__main__":
    main(tyro.cli(Options, description=Options.__doc__))
