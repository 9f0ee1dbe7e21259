"""The tables of an evaluation: texts, for the terminal, Markdown, LaTeX and CSV."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import Any, Literal

from rich import box
from rich.table import Table

from evaluate.statistics import wilson95
from evaluate.summary import is_papers, unusual

Format = Literal["text", "md", "latex", "csv"]

# Section V of the paper: 496 of 500 succeed, in 27 to 180 s, with d_min = 0.18 m; section VI: 0.15 s.
_PAPER = "paper (quoted)"
_LATEX = str.maketrans(
    {**{sign: f"\\{sign}" for sign in "&%$#_{}"}, "|": "$|$", "<": "$<$", "\\": "/"}
)


@dataclass(frozen=True)
class TextTable:
    """A table of texts.

    Attributes:
        title: What it shows.
        columns: Heads of the columns.
        rows: A row for each policy, its name first.
        quoted: A row of the paper's figures that comes first, where it compares.
    """

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]
    quoted: tuple[str, ...] | None = None

    @property
    def _shown(self) -> list[tuple[str, ...]]:
        """All rows in their order."""
        return [*filter(None, [self.quoted]), *self.rows]

    def rich(self, style: box.Box | None = None) -> Table:
        """For the terminal, or in another box."""
        table = Table(padding=(0, 1, 0, 0), box=style)
        table.add_column(self.columns[0], style="bold", overflow="fold")  # a name may be a path
        for k, column in enumerate(self.columns[1:], 1):
            least = max(len(text) for text in (*column.split(), *(row[k] for row in self._shown)))
            table.add_column(column, justify="right", min_width=least)
        if self.quoted is not None:
            table.add_row(*self.quoted, style="dim italic")
        for row in self.rows:
            table.add_row(*row)
        return table

    def latex(self) -> str:
        """For a paper, with the rules of booktabs."""
        lines = [
            " & ".join(text.translate(_LATEX) for text in row) + r" \\"
            for row in (self.columns, *self._shown)
        ]
        begin = rf"\begin{{tabular}}{{l{'r' * (len(self.columns) - 1)}}}"
        body = [r"\toprule", lines[0], r"\midrule", *lines[1:], r"\bottomrule"]
        return "\n".join([f"% {self.title}", begin, *body, r"\end{tabular}"])

    def csv(self) -> str:
        """For a program."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([self.columns, *self._shown])
        return text.getvalue().rstrip("\n")


def result_tables(summary: dict[str, Any]) -> list[TextTable]:
    """Success and time of each policy, its motion, and the cost of a decision."""
    like_paper = is_papers(summary)
    policies = summary["policies"].items()
    outcomes = [
        (
            name,
            f"{row['success']}/{row['n']}",
            interval(row["wilson95"]),
            *(_number(row["time_s"][key], ".0f") for key in ("min", "median")),
            *(_number(row["time_s"]["mean"], ".1f"), _number(row["time_s"]["max"], ".0f")),
        )
        for name, row in policies
    ]
    motions = [
        (
            name,
            *(_number(row["d_min"], ".3f"), _number(row["max_abs_phi"], ".4f")),
            _number(row["shape_error_rad"]["median"], ".3f"),
            _number(1000.0 * row["head_error_m"], ".1f"),
            _number(row["cost_integral"], ".1f"),
        )
        for name, row in policies
    ]
    costs = [
        (
            name,
            _number(row["rollouts_per_decision"], ".1f"),
            *(_number(row["decision_latency_us"][key], ".0f") for key in ("p50", "p95")),
        )
        for name, row in policies
    ]
    quoted = (
        (_PAPER, "496/500", interval(wilson95(496, 500)), "27", "-", "-", "180"),
        (_PAPER, "0.18", "<= pi/2", "-", "-", "-"),
        (_PAPER, "<= 99", "-", "<= 150000"),
    )
    times = ("policy", "success", "95 % CI", "min", "median", "mean", "max [s]")
    motion = (
        *("policy", "d_min [m]", "max |phi| [rad]", "shape error [rad]", "head error [mm]"),
        "integral of V [s]",
    )
    cost = ("policy", "roll-outs", "p50 [us]", "p95 [us]")
    tables = (
        (_title(summary), times, outcomes),
        ("motion", motion, motions),
        ("cost of a decision", cost, costs),
    )
    return [
        TextTable(*table, first if like_paper else None)
        for table, first in zip(tables, quoted, strict=True)
    ]


def _title(summary: dict[str, Any]) -> str:
    """The tasks, the robot, and what is unusual about both."""
    tasks = summary["tasks"]
    count = f"{tasks['n']:,} task" + ("s" if tasks["n"] != 1 else "")
    return ", ".join(
        [f"{tasks['name']}: {count}", f"preset {summary['preset']}", *unusual(summary)]
    )


def printed(table: TextTable, form: Format) -> str | Table:
    """A table as it is printed."""
    if form == "latex":
        return table.latex()
    if form == "csv":
        return table.csv()
    return table.rich(box.MARKDOWN if form == "md" else None)


def failure_lines(summary: dict[str, Any]) -> list[str]:
    """For each policy with failures, a line that says which and where."""
    lines = []
    for name, row in summary["policies"].items():
        causes = ", ".join(f"{count} {cause}" for cause, count in row["failures_by_phase"].items())
        if causes:
            lines.append(f"{name} fails: {causes}")
    return lines


def interval(bounds: Any) -> str:
    """A range of shares, in per cent."""
    low, high = bounds
    return f"{100 * low:.1f}-{100 * high:.1f}"


def _number(value: float | None, spec: str) -> str:
    return "-" if value is None else format(value, spec)
