"""The table in the terminal: our figures beside the paper's."""

from __future__ import annotations

import dataclasses
from typing import Any

from rich.table import Table

from evaluate.statistics import wilson95
from snake_env.params import SnakeParams

# Section V of the paper: 496 of 500 succeed, in 27 to 180 s, with d_min = 0.18 m.
_PAPER = ("the paper (quoted)", 496, 500)


def result_table(summary: dict[str, Any]) -> Table:
    """The policies' figures, one row each, with the paper's row where it is comparable."""
    title = f"{summary['tasks']['name']}: {summary['tasks']['n']} tasks, preset {summary['preset']}"
    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column("policy", style="bold", no_wrap=True)
    for name in (
        "success",
        "95 %",
        "time min / median / mean / max [s]",
        "d_min [m]",
        "max |phi|",
        "int V [s]",
        "head off [m, rad]",
        "roll-outs",
        "us per decision p50 / p95",
    ):
        table.add_column(name, justify="right")
    if summary["params"] == dataclasses.asdict(SnakeParams()):
        name, successes, n = _PAPER
        table.add_row(
            *(
                name,
                f"{successes}/{n}",
                _interval(wilson95(successes, n)),
                "27 / - / - / 180",
                "0.18",
            ),
            *("<= pi/2", "-", "-", "99 in phase 1", "150000 at most"),
            style="dim italic",
        )
    for name, row in summary["policies"].items():
        time, latency = row["time_s"], row["decision_latency_us"]
        table.add_row(
            name,
            f"{row['success']}/{row['n']}",
            _interval(row["wilson95"]),
            " / ".join(_number(time[key], ".0f") for key in ("min", "median"))
            + " / "
            + " / ".join(
                _number(time[key], spec) for key, spec in (("mean", ".1f"), ("max", ".0f"))
            ),
            _number(row["d_min"], ".3f"),
            _number(row["max_abs_phi"], ".4f"),
            _number(row["cost_integral"], ".1f"),
            f"{_number(row['head_error_m'], '.2f')}, {_number(row['head_error_rad'], '.2f')}",
            _number(row["rollouts_per_decision"], ".1f"),
            f"{_number(latency['p50'], '.0f')} / {_number(latency['p95'], '.0f')}",
        )
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
    return f"{100 * low:.1f}-{100 * high:.1f} %"


def _number(value: float | None, spec: str) -> str:
    return "-" if value is None else format(value, spec)
