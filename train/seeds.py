"""Several runs that differ in their seed only, side by side, and how much that makes."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from harness.engine import Engine
from harness.folder import writable_folder
from harness.provenance import words_without
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import read_model
from snake_env.system.files import write_atomically
from train.jobs import Job, side_by_side
from train.validation import quality

_MOST = 1000
_FIGURES = {
    "raw_success": ("raw success", "{:.2%}"),
    "raw_time_s": ("time [s]", "{:.2f}"),
    "critic_success": ("+critic success", "{:.2%}"),
    "critic_time_s": ("time [s] ", "{:.2f}"),
}


def train_seeds(command: str, options: Any, words: Sequence[str], console: Console) -> None:
    """Trains ``options.run.seeds`` runs, each in the folder that it would have alone.

    Args:
        command: What learns.
        options: The command's options.
        words: The command line that they came from.
        console: Where progress and the spread are shown.
    """
    if not 1 <= options.run.seeds <= _MOST:
        raise InvalidInputError("seeds", options.run.seeds, f"a positive number, at most {_MOST}")
    last = options.run.seed + options.run.seeds - 1
    for seed in (options.run.seed, last):
        dataclasses.replace(options.run, seed=seed).folder(command)  # before there is work to lose
    options.engine.check()
    shared = words_without(words, "--seeds", "--seed", "--out")
    runs = []
    for seed in range(options.run.seed, last + 1):
        out = _folder(command, options, f"s{seed}")
        alone = dataclasses.replace(options.run, seed=seed, seeds=1, out=out)
        own = dataclasses.replace(options, run=alone, engine=Engine(workers=1))
        runs.append(Job(command, own, [*shared, "--seed", str(seed)]))
    side_by_side(runs, options.engine, console)
    folder = _folder(command, options, "seeds")
    _report(folder, [job.folder for job in runs], console)


def _folder(command: str, options: Any, suffix: str) -> Path:
    """``--out``, or what stands for it, with a suffix."""
    method = getattr(options, "method", command)
    name = options.run.out or Path("runs") / f"{method}-{options.robot.name}"
    if name.name in ("", ".."):
        raise InvalidInputError(
            "out", str(name), f"a folder with a name, to which -{suffix} is added"
        )
    return name.with_name(f"{name.name}-{suffix}")


def _report(folder: Path, runs: Sequence[Path], console: Console) -> None:
    """Shows what the best models are worth, and keeps it: ``seeds.json``, ``curve.png``."""
    best = {run.name: validation for run in runs for validation in _validation(run)}
    if not best:
        return  # a value network is not validated
    writable_folder(folder)
    write_atomically(folder / "seeds.json", json.dumps(best, indent=1) + "\n")
    from train.curves import draw_curves  # matplotlib takes a while to import

    draw_curves(runs, folder / "curve.png")
    table = Table(box=None, title="best models, on tasks of validation-2k", title_justify="left")
    table.add_column("seed")
    for title, _ in _FIGURES.values():
        table.add_column(title, justify="right")
    ranked = sorted(best, key=lambda name: quality(best[name]), reverse=True)
    places = {0: "best", len(ranked) // 2: "median", len(ranked) - 1: "worst"}
    for place, name in enumerate(ranked):
        figures = [form.format(best[name][key]) for key, (_, form) in _FIGURES.items()]
        table.add_row(f"{name} {places.get(place, '')}", *figures)
    console.print(table)
    console.print(f"learning curves: {folder / 'curve.png'}", soft_wrap=True)


def _validation(run: Path) -> Iterator[dict[str, float]]:
    """What the run's best model achieved, where it was validated."""
    if (run / "best.safetensors").is_file():
        yield dict(read_model(run / "best.safetensors").made["validation"])
