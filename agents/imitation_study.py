"""Which options of imitation help? ``python -m agents.imitation_study --lessons RUN``.

Networks learn from the same judgements of a run of ``train imitate`` and are asked about others that
none has seen: how often is the preferred mode infeasible, and what does it cost more than the best?
"""

from __future__ import annotations

import dataclasses
import functools
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import tyro
from rich.table import Table

from agents.imitate import Fit, Lessons, fit, lessons_of
from evaluate.command import console as make_console
from evaluate.command import exit_code
from evaluate.engine import Engine
from evaluate.options import parse
from evaluate.progress import progress
from snake_env.network import Float32Array
from snake_env.symmetry import SymmetricNetwork, joints_observed


@dataclass(frozen=True)
class Options:
    """Compare options of imitation on held-out judgements."""

    engine: Engine = field(default_factory=Engine)
    lessons: Annotated[Path, tyro.conf.arg(metavar="RUN")] = Path("runs/imitate-paper-s0")
    """Folder of a run of train imitate."""
    decisions: int = 250_000
    """Judgements to learn from; a tenth of so many more are held out."""
    seeds: int = 2
    """Networks for each choice of options."""


CHOICES: dict[str, list[dict[str, Any]]] = {
    "as it ships": [{}],
    "hidden layers": [{"hidden": h} for h in ((384, 384), (256, 256, 128), (640, 640, 320))],
    "violation": [{"violation": v} for v in (30.0, 300.0)],
    "cross_entropy": [{"cross_entropy": w} for w in (0.0, 1.0)],
    "values": [{"values": w} for w in (0.0, 100.0)],
    "batch_size": [{"batch_size": b} for b in (256, 2048)],
    "learning_rate": [{"learning_rate": r} for r in (5e-4, 2e-3)],
    "last_epochs": [{"last_epochs": e} for e in (4, 16)],
}
"""What is compared: one option after the other is changed."""


@dataclass(frozen=True)
class Trial:
    """One network to learn."""

    options: Options
    name: str
    change: dict[str, Any]
    seed: int


def trials(options: Options) -> Iterator[Trial]:
    """All networks."""
    for name, changes in CHOICES.items():
        for change in changes:
            for seed in range(options.seeds):
                yield Trial(options, name, change, seed)


def run_trial(trial: Trial) -> tuple[Trial, tuple[float, float]]:
    """Learns, and asks: what :func:`held_out` says."""
    torch.set_num_threads(1)
    learned, other = split(trial.options.lessons, trial.options.decisions)
    n_joints = joints_observed(learned.observations.shape[1])
    how = dataclasses.replace(Fit(), **trial.change)
    network, _ = fit(None, [learned], how, n_joints, trial.seed, last=True)
    return trial, held_out(SymmetricNetwork(network, n_joints), other)


def held_out(
    network: Callable[[Float32Array], Float32Array], lessons: Lessons
) -> tuple[float, float]:
    """Share of infeasible preferences [%], and mean regret of the others [intervals]."""
    cost = lessons.cost.astype(np.float64)
    preferred = np.where(cost >= 0.0, network(lessons.observations), -np.inf).argmax(axis=1)
    taken = cost[np.arange(len(cost)), preferred]
    best = np.where(cost >= 0.0, cost, np.inf).min(axis=1)
    feasible = np.isfinite(taken)
    return 100.0 * float(1.0 - feasible.mean()), float((taken - best)[feasible].mean())


@functools.lru_cache(maxsize=1)  # a worker reads them once for all of its networks
def split(run: Path, decisions: int, seed: int = 0) -> tuple[Lessons, Lessons]:
    """Judgements to learn from, and others.

    Raises:
        InvalidInputError: The run has none.
    """
    lessons = lessons_of(run)
    observations = np.concatenate([part.observations for part in lessons])
    cost = np.concatenate([part.cost for part in lessons])
    order = np.random.default_rng(seed).permutation(len(cost))
    cut = min(decisions, len(order) * 10 // 11)
    parts = order[:cut], order[cut : cut + math.ceil(cut / 10)]
    learned, other = (Lessons(observations[part], cost[part]) for part in parts)
    return learned, other


def _value(change: dict[str, Any]) -> str:
    return ", ".join(map(str, change.values())) or "-"


def main(options: Options) -> int:
    """Learns, asks and prints; the exit code."""
    options.engine.check()
    learned, other = split(options.lessons, options.decisions)
    console = make_console()
    console.print(f"{len(learned.cost)} judgements to learn from, {len(other.cost)} held out")
    todo = list(trials(options))
    found: dict[tuple[str, str], list[tuple[float, float]]] = {}
    with progress(console, len(todo), "networks") as advance:
        for trial, figures in options.engine.map(run_trial, todo):
            found.setdefault((trial.name, _value(trial.change)), []).append(figures)
            advance(trial.name, 1)
    table = Table(box=None)
    for column in ("option", "value", "infeasible [%]", "regret of the others [intervals]"):
        table.add_column(column, justify="right" if "[" in column else "left")
    for name, value in dict.fromkeys((trial.name, _value(trial.change)) for trial in todo):
        own = np.array(found[name, value])
        means, spread = own.mean(axis=0), np.ptp(own, axis=0) / 2.0
        shown = (f"{m:.3f} +- {s:.3f}" for m, s in zip(means, spread, strict=True))
        table.add_row(name, value, *shown)
    console.print(table)
    return 0


if __name__ == "__main__":
    # Other processes find by the module's name what a cache hides from pickling by value.
    from agents import imitation_study as study

    sys.exit(
        exit_code(lambda: study.main(parse(study.Options, "python -m agents.imitation_study")))
    )
