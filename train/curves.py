"""Learning curves of runs, from their logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from harness.figures import Figure, save, style
from train.records import read_log

_PANELS = (
    ("tasks solved, raw [%]", "raw_success", 100.0),
    ("tasks solved, +critic [%]", "critic_success", 100.0),
    ("mean time of successes, raw [s]", "raw_time_s", 1.0),
)
"""Title, column of the log, and what its numbers are multiplied by."""


def draw_curves(runs: Sequence[Path], out: Path) -> None:
    """Draws the validations of some runs, a line each, beside one another."""
    with style({"text.parse_math": False}):  # names of folders are no formulas
        save(_curves(runs), out)


def _curves(runs: Sequence[Path]) -> Figure:
    figure = Figure(figsize=(10.0, 3.0), layout="constrained", dpi=130)
    axes = figure.subplots(1, len(_PANELS))
    rows: list[dict[str, str]] = []
    for run in runs:
        rows = [row for row in read_log(run / "log.csv") if row.get("raw_success")]
        steps = [float(row.get("round") or int(row["timesteps"]) / 1e6) for row in rows]
        for axis, (_, key, factor) in zip(axes, _PANELS, strict=True):
            values = [factor * float(row[key] or "nan") for row in rows]
            axis.plot(steps, values, label=run.name, marker=".")
    for axis, (title, _, _) in zip(axes, _PANELS, strict=True):
        if not np.isfinite([y for line in axis.lines for y in line.get_ydata()]).any():
            axis.set_visible(False)  # nothing was solved: there is no time
        axis.set_title(title, fontsize=9, loc="left")
        axis.set_xlabel("round" if rows and "round" in rows[0] else "million decisions")
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    if len(runs) > 1:
        lines, names = axes[0].get_legend_handles_labels()
        figure.legend(lines, names, loc="outside lower center", ncols=5, frameon=False, fontsize=8)
    return figure
