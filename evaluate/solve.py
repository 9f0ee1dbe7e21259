"""``python -m evaluate solve``: the shortest plans that a wide search finds for a suite of tasks."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console

from evaluate.plans import COLUMNS, Problem, Row, solve
from harness.engine import Engine
from harness.files import file_name
from harness.folder import Found, Layout, held
from harness.journal import Journal, check_finished
from harness.progress import progress
from harness.provenance import command
from harness.robot import Robot
from snake_env.errors import InvalidInputError
from snake_env.params import SnakeParams
from snake_env.policies.value import value_digest
from snake_env.sim.tasks import TaskSuite, load_tasks
from snake_env.sim.warm_up import warm_up
from snake_env.system.files import write_atomically

LAYOUT = Layout(begun="plans.partial.jsonl", done="search.json", own=("plans.csv",))
"""What the folder of a search holds."""


@dataclass(frozen=True)
class SolveOptions:
    """Search a suite of tasks for the shortest plans."""

    robot: Robot = field(default_factory=Robot)
    engine: Engine = field(default_factory=Engine)
    tasks: str = "paper-500"
    """A suite of tasks, as for evaluate."""
    budget: int = 100_000
    """Roll-outs per task; analytic needs about 400."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for plans.csv; default: runs/solve- and the suite."""
    improve: Annotated[Path | None, tyro.conf.arg(metavar="CSV")] = None
    """Initial plans: the plans.csv of another search of the same tasks."""
    resume: bool = False
    """Continue the interrupted search in the folder."""
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


def solve_suite(options: SolveOptions, console: Console) -> None:
    """Searches all tasks, or those that an interrupted search has left; writes the plans.

    A task's result depends on the task, the budget and the value network only: not on the workers.
    """
    params = options.check()
    suite = load_tasks(options.tasks, params)
    known = _known(options.improve, len(suite))
    folder = options.out or Path("runs") / f"solve-{file_name(options.tasks)}"
    options.engine.check()
    config = {
        "tasks": [suite.name, len(suite), suite.sha256],
        "params": asdict(params),
        "budget": options.budget,
        "value": value_digest(params, options.robot.transfer),
        "improve": hashlib.sha256(json.dumps(known).encode()).hexdigest(),
    }
    flags = {"overwrite": options.overwrite, "resume": options.resume}
    with held(folder, LAYOUT, **flags) as found:
        _search(options, params, suite, known, config, folder, found, console)


def _search(
    options: SolveOptions,
    params: SnakeParams,
    suite: TaskSuite,
    known: list[tuple[int, ...]],
    config: dict[str, Any],
    folder: Path,
    found: Found,
    console: Console,
) -> None:
    file = folder / "plans.csv"
    rows: dict[int, Row] = {}
    if found == "finished":
        check_finished(folder / LAYOUT.done, config)
        console.print(f"this search is finished: {file}", soft_wrap=True)
        return

    def take(row: Any) -> None:
        rows[_checked(row, len(suite))["task"]] = row

    journal = Journal(folder / LAYOUT.begun, config, resume=found == "begun", take=take)
    warm_up(params)
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
        folder / LAYOUT.done, json.dumps({"command": command(), **config}, indent=1) + "\n"
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


def _checked(row: Any, count: int) -> Row:
    """A task's row of the journal.

    Raises:
        ValueError, TypeError: It is none.
    """
    if tuple(row) != COLUMNS or not isinstance(row["modes"], str):
        raise ValueError("other columns")
    if type(row["task"]) is not int or not 0 <= row["task"] < count:
        raise ValueError("there is no such task")
    if row["time_s"] != "" and not 0.0 <= row["time_s"] < math.inf:
        raise ValueError("an invalid time")
    return row  # type: ignore[no-any-return]


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
