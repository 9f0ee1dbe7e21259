"""The report of an evaluation: ``report.html``, one file that needs and fetches nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evaluate.protocol import Row
from evaluate.report.page import render
from evaluate.report.replays import collect, sim_1
from snake_env.params import SnakeParams
from snake_env.sim.tasks import TaskSuite
from snake_env.system.files import write_atomically

FILE = "report.html"


def write_report(
    folder: Path,
    policies: Sequence[str],
    rows: Mapping[str, Sequence[Row]],
    summary: Mapping[str, Any],
    params: SnakeParams,
    suite: TaskSuite,
    decision_timeout_s: float | None = None,
) -> Path:
    """Writes ``report.html``.

    Args:
        folder: Where to.
        policies: The policies in their order; the first is the one that others are compared with.
        rows: Their episodes, by task.
        summary: What ``summary.json`` holds.
        params: The constants.
        suite: The tasks.
        decision_timeout_s: What a decision may take [s]; None: any time.

    Returns:
        The file's path.
    """
    episodes = [
        *sim_1(rows, params, suite, decision_timeout_s),
        *collect(policies, rows, params, suite),
    ]
    path = folder / FILE
    write_atomically(path, render(policies, rows, summary, params, episodes))
    return path
