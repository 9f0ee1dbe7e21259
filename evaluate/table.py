"""The tables in the terminal, for 80 columns and more: our figures beside the paper's."""

from __future__ import annotations

import dataclasses
from typing import Any

from rich.table import Table

from evaluate.statistics import wilson95
from snake_env.params import SnakeParams

# Section V of the paper: 496 of 500 succeed, in 27 to 180 s, with d_min = 0.18 m; section VI: 0.15 s.
_PAPER = "paper (quoted)"


def result_tables(summary: dict[str, Any]) -> list[tuple[str, Table]]:
    """Success and time of each policy, then motion and cost; with the paper where it compares.

    Returns:
        Titles and tables.
    """
    tasks = summary["tasks"]
    title = f"{tasks['name']}: {tasks['n']} tasks, preset {summary['preset']}"
    outcome = _table("success", "95 %", "min", "median", "mean", "max [s]")
    motion = _table(
        *("d_min [m]", "max |phi|", "int V", "head off [m]", "off [rad]"),
        *("roll-outs", "p50", "p95 [us]"),
    )
    if summary["params"] == dataclasses.asdict(SnakeParams()):
        outcomes = (_PAPER, "496/500", _interval(wilson95(496, 500)), "27", "-", "-", "180")
        outcome.add_row(*outcomes, style="dim italic")
        motions = (_PAPER, "0.18", "<= pi/2", "-", "-", "-", "<= 99", "-", "150000")
        motion.add_row(*motions, style="dim italic")
    for name, row in summary["policies"].items():
        time, latency = row["time_s"], row["decision_latency_us"]
        outcome.add_row(
            name,
            f"{row['success']}/{row['n']}",
            _interval(row["wilson95"]),
            *(_number(time[key], ".0f") for key in ("min", "median")),
            *(_number(time["mean"], ".1f"), _number(time["max"], ".0f")),
        )
        motion.add_row(
            name,
            _number(row["d_min"], ".3f"),
            _number(row["max_abs_phi"], ".4f"),
            _number(row["cost_integral"], ".1f"),
            *(_number(row[f"head_error_{unit}"], ".2f") for unit in ("m", "rad")),
            _number(row["rollouts_per_decision"], ".1f"),
            *(_number(latency[key], ".0f") for key in ("p50", "p95")),
        )
    return [(title, outcome), ("motion and cost of a decision", motion)]


def _table(*columns: str) -> Table:
    table = Table(padding=(0, 1, 0, 0), box=None)
    table.add_column("policy", style="bold", no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=" " not in column)
    return table


def failure_lines(summary: dict[str, Any]) -> list[str]:
    """For each policy with failures, a line that says which and where."""
    lines = []
    for name, row in summary["policies"].items():
        causes = ", ".join(f"{count} {cause}" for cause, count in row["failures_by_phase"].items())
        if causes:
            lines.append(f"{name} fails: {causes}")
    return lines


def _interval(bounds: Any) -> str:
    low, high = bounds
    return f"{100 * low:.1f}-{100 * high:.1f}"


def _number(value: float | None, spec: str) -> str:
    return "-" if value is None else format(value, spec)
