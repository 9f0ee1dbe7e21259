"""``python -m train solve``: the shortest plans that a wide search finds."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import joblib
import numpy as np
import tyro
from rich.console import Console

from agents.best_known import COLUMNS, Problem, Row, solve
from evaluate.engine import Engine
from evaluate.journal import Journal, writable_folder, write_atomically
from evaluate.progress import progress
from snake_env.errors import InvalidInputError
from snake_env.params import SnakeParams
from snake_env.policies.warm_up import warm_up
from snake_env.sim.tasks import load_tasks
from train.run import Robot, command, value_digest


@dataclass(frozen=True)
class Options:
    """Search a suite of tasks for the shortest plans."""

    robot: Robot = field(default_factory=Robot)
    engine: Engine = field(default_factory=Engine)
    tasks: str = "paper-500"
    """A suite of tasks, as for evaluate."""
    budget: int = 100_000
    """Model roll-outs for each task; (21) needs about 400."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for plans.csv; default: runs/solve- and the suite."""
    improve: Annotated[Path | None, tyro.conf.arg(metavar="CSV")] = None
    """Plans to begin with: the plans.csv of another search of the same tasks."""
    resume: bool = False
    """Go on with the interrupted search in the folder."""
    overwrite: bool = False
    """Replace the plans in the folder."""

    def check(self) -> SnakeParams:
        """The constants that the options ask for.

        Raises:
            SnakeEnvError: An option's value can't be used.
        """
        if self.budget < 1:
            raise InvalidInputError("budget", self.budget, "a positive number of roll-outs")
        if self.overwrite and self.resume:
            raise InvalidInputError("overwrite", True, "one of --overwrite and --resume")
        return self.robot.params()


def train(options: Options, console: Console) -> None:
    """Searches all tasks, or those that an interrupted search has left; writes the plans.

    A task's result depends on the task, the budget and the value network only: not on the workers.
    """
    params = options.check()
    suite = load_tasks(options.tasks, params)
    known = _known(options.improve, len(suite))
    folder = options.out or Path("runs") / f"solve-{options.tasks.replace(':', '-')}"
    options.engine.check()
    config = {
        "tasks": [suite.name, len(suite), joblib.hash((suite.phi0, suite.target))],
        "params": asdict(params),
        "budget": options.budget,
        "value": value_digest(params, options.robot.transfer),
        "improve": joblib.hash(known),
    }
    partial, file = folder / "plans.partial.jsonl", folder / "plans.csv"
    if not options.resume:
        writable_folder(folder)
        if (file.exists() or partial.exists()) and not options.overwrite:
            expected = "a folder without plans (or --overwrite, or --resume to go on)"
            raise InvalidInputError("out", str(folder), expected)
    journal = Journal(partial, config, resume=options.resume)
    warm_up(params)
    rows: dict[int, Row] = {row["task"]: row for row in journal.entries}
    problems = [
        Problem(
            task,
            suite.initial(task, params),
            known[task],
            options.budget,
            params,
            options.robot.transfer,
        )
        for task in range(len(suite))
        if task not in rows
    ]
    try:
        with progress(console, len(problems), "tasks") as advance:
            for row in options.engine.map(solve, problems):
                rows[row["task"]] = row
                journal.append(row)
                advance("solve", 1)
    except KeyboardInterrupt:
        console.print(f"{len(rows)} of {len(suite)} tasks are kept in {folder}", soft_wrap=True)
        raise
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows[task] for task in sorted(rows))
    write_atomically(file, text.getvalue())
    write_atomically(
        folder / "search.json", json.dumps({"command": command(), **config}, indent=1) + "\n"
    )
    journal.remove()
    times = [row["time_s"] for row in rows.values() if row["time_s"] != ""]
    console.print(
        f"{len(times)} of {len(suite)} tasks solved"
        + (f", {np.mean(times):.2f} s on average" if times else "")
        + f": {file}",
        soft_wrap=True,
    )
    for row in rows.values():
        if row["time_s"] == "":
            verdict = (
                f"impossible: every way deadlocks in phase {row['phase']} at the latest"
                if row["impossible"]
                else f"no plan in {row['rollouts']} roll-outs"
            )
            console.print(f"task {row['task']}: {verdict}")


def _known(path: Path | None, count: int) -> list[tuple[int, ...]]:
    """The modes of each task's known plan, or nothing."""
    known: list[tuple[int, ...]] = [()] * count
    if path is None:
        return known
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                task, modes = int(row["task"]), row["modes"] or ""
                if not 0 <= task < count:
                    raise ValueError(f"there is no task {task}")
                known[task] = tuple(map(int, modes.split()))
    except (OSError, KeyError, ValueError, csv.Error) as error:
        expected = f"the plans.csv of a search of these tasks ({error})"
        raise InvalidInputError("improve", str(path), expected) from None
    return known
