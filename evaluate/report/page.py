"""Fills the page: what ``page.html.jinja`` is given."""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from evaluate.protocol import Row, chooses_modes
from evaluate.report import charts, paper_figures, svg
from evaluate.report.charts import Entry
from evaluate.report.episodes import mode_choosing
from evaluate.report.findings import findings, headline
from evaluate.report.formats import (
    constant,
    estimate,
    interval,
    milliseconds,
    number,
    p_value,
)
from evaluate.report.motion import motion_of
from evaluate.report.replays import SIM_1, Replayed, data
from evaluate.statistics import wilson95
from evaluate.summary import is_papers, unusual
from snake_env.params import SnakeParams

_HERE = Path(__file__).parent
_SCRIPTS = ("robot.js", "traces.js", "player.js", "page.js")
_PAPER_SUCCESS = (496, 500)  # section V


def render(
    policies: Sequence[str],
    rows: Mapping[str, Sequence[Row]],
    summary: Mapping[str, Any],
    params: SnakeParams,
    episodes: Sequence[Replayed],
) -> str:
    """The page as HTML.

    Args:
        policies: The policies in their order.
        rows: Their episodes, by task.
        summary: What ``summary.json`` holds.
        params: The constants.
        episodes: What to replay.
    """
    reference = mode_choosing(policies)[0]
    entries = [
        Entry(name, style, summary["policies"][name], _ratio(name, reference, rows, summary))
        for style, name in enumerate(policies)
    ]
    compared = [entry for entry in entries if chooses_modes(entry.name)] or entries
    like_paper = is_papers(summary)
    replays = data(policies, episodes, params)
    environment = Environment(
        loader=FileSystemLoader(_HERE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html.jinja").render(
        summary=summary,
        style=_asset("style.css"),
        script=Markup("\n").join(_asset(name) for name in _SCRIPTS),
        headline=headline(compared, summary),
        findings=findings(summary),
        unusual=unusual(summary),
        table=[_cells(entry) for entry in entries],
        like_paper=like_paper,
        paper_interval=interval(wilson95(*_PAPER_SUCCESS)),
        has_skid=not all(map(chooses_modes, policies)),
        has_latency=any(e.figures["decision_latency_us"]["p50"] is not None for e in entries),
        legend=[(entry.name, svg.key(entry.style)) for entry in compared],
        charts=_charts(compared, rows, like_paper),
        pairs=_pairs(summary),
        failures=_failures(policies, rows, params),
        sides=("left", "right") if len(mode_choosing(policies)) > 1 else ("left",),
        replayed={episode["name"] for episode in replays["episodes"]},
        replays=_json(replays),
        frame_s=replays["robot"]["frame_s"],
        quantum=replays["robot"]["quantum"],
        any_replay=bool(replays["episodes"]),
        figure_4=[(name, paper_figures.figure_4(name, rows[name], params)) for name in policies],
        figure_5=_figure_5(policies, episodes, params),
        models=[(name, summary["models"][name]) for name in policies if summary["models"][name]],
        constants=_constants(params),
        today=date.today().isoformat(),
    )


def _asset(name: str) -> Markup:
    return Markup((_HERE / name).read_text(encoding="utf-8"))  # our own file


def _json(value: Any) -> Markup:
    """JSON inside a script element: no text in it can close that element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))


def _ratio(
    name: str,
    reference: str,
    rows: Mapping[str, Sequence[Row]],
    summary: Mapping[str, Any],
) -> Mapping[str, float] | None:
    """Mean time over the reference's, on the tasks that both solve."""
    for comparison in summary.get("comparisons") or ():
        if (comparison["reference"], comparison["policy"]) == (reference, name):
            ratio: Mapping[str, float] | None = comparison.get("time_ratio")
            return ratio
    own, first = (
        {row["task"]: row["time_s"] for row in rows[policy] if row["outcome"] == "success"}
        for policy in (name, reference)
    )
    common = own.keys() & first.keys()
    base = sum(first[task] for task in common)
    return {"mean": sum(own[task] for task in common) / base} if base > 0 else None


def _pairs(summary: Mapping[str, Any]) -> list[dict[str, str]]:
    """The comparisons as rows of texts."""
    return [
        {
            "policy": comparison["policy"],
            "only_policy": str(comparison["only_policy"]),
            "only_reference": str(comparison["only_reference"]),
            "mcnemar": p_value(comparison.get("mcnemar_p_holm")),
            "common": str(comparison["common"]),
            "ratio": estimate(comparison.get("time_ratio"), 3),
            "difference": estimate(comparison.get("time_difference_s"), 1),
            "wilcoxon": p_value(comparison.get("wilcoxon_p_holm", comparison.get("wilcoxon_p"))),
            "restricted": estimate(comparison.get("restricted_time_difference_s"), 1),
            "improvement": estimate(comparison.get("probability_of_improvement"), 2),
        }
        for comparison in summary.get("comparisons") or ()
    ]


def _cells(entry: Entry) -> dict[str, Any]:
    """A row of the results table: texts."""
    figures, time = entry.figures, entry.figures["time_s"]
    latency = figures["decision_latency_us"]
    ratio = (entry.ratio or {}).get("mean") if chooses_modes(entry.name) else None
    return {
        "name": entry.name,
        "success": f"{figures['success']}/{figures['n']}",
        "rate": f"{100 * figures['success_rate']:.1f}",
        "interval": interval(figures["wilson95"]),
        "times": [number(time[key], 0) for key in ("min", "median")]
        + [number(time["mean"], 1), number(time["max"], 0)],
        "ratio": number(ratio, 3),
        "d_min": number(figures["d_min"], 3),
        "max_abs_phi": number(figures["max_abs_phi"], 3),
        "shape": number(figures["shape_error_rad"]["median"], 3),
        "head": number(1000.0 * figures["head_error_m"], 1),
        "skids": not chooses_modes(entry.name),
        "rollouts": number(figures["rollouts_per_decision"], 1),
        "latency": [milliseconds(latency.get(key)) for key in ("p50", "p95")],
    }


def _charts(
    entries: Sequence[Entry], rows: Mapping[str, Sequence[Row]], like_paper: bool
) -> list[dict[str, Any]]:
    """The comparison's charts, each with a title and what to see in it."""
    hits, tasks = _PAPER_SUCCESS
    paper = (hits / tasks, *wilson95(hits, tasks)) if like_paper else None
    first = entries[0].name
    made = [
        ("Success rate", "Success rate with its 95 % Wilson interval.",
         charts.success_chart(entries, paper)),
        ("Tasks solved over time", "Share of the tasks solved within a time: higher is better.",
         charts.profile_chart(entries, rows)),
    ]  # fmt: skip
    if len(entries) > 1:  # one policy would be one point
        made.append(("Success against roll-outs",
                     "Success against model roll-outs per decision.",
                     charts.rollouts_chart(entries)))  # fmt: skip
        if any(entry.figures["decision_latency_us"]["p50"] is not None for entry in entries):
            caption = (
                "Success against the 95th percentile of the time per decision, on this machine."
            )
            clock = charts.latency_chart(entries, like_paper)
            made.append(("Success against decision time", caption, clock))
        caption = f"Mean time over that of {first}, on the tasks that both solve"
        made.insert(1, ("Mean time", f"{caption}: left is better.", charts.ratio_chart(entries)))
        made.append(("Mean time against roll-outs", f"{caption}, against roll-outs: low is better.",
                     charts.time_cost_chart(entries)))  # fmt: skip
    return [{"title": title, "caption": caption, "svg": chart} for title, caption, chart in made]


def _failures(
    policies: Sequence[str], rows: Mapping[str, Sequence[Row]], params: SnakeParams
) -> list[dict[str, Any]]:
    """Failures by policy, cause and phase, with the tasks concerned."""
    table = []
    phases = range(1, params.n_joints + 1)
    for policy in policies:
        failed = [row for row in rows[policy] if row["outcome"] != "success"]
        for cause in sorted({row["outcome"] for row in failed}):
            own = [row for row in failed if row["outcome"] == cause]
            counts = Counter(row["phase"] for row in own)
            table.append(
                {
                    "policy": policy,
                    "cause": cause.replace("_", " "),
                    "counts": [counts[phase] for phase in phases],
                    "shades": [round(60 * (counts[phase] / len(rows[policy])) ** 0.5)
                               for phase in phases],
                    "total": len(own),
                    "tasks": [row["task"] for row in own],
                    "error": own[0]["error"],
                }
            )  # fmt: skip
    return table


def _figure_5(
    policies: Sequence[str], episodes: Sequence[Replayed], params: SnakeParams
) -> dict[str, Any] | None:
    """sim-1 by the first policy that chooses modes."""
    policy = mode_choosing(policies)[0]
    found = [episode for episode in episodes if episode.name == SIM_1]
    if not found or not found[0].rows[policy]["modes"]:
        return None
    row, state = found[0].rows[policy], found[0].state
    motion = motion_of(row, state, params)
    error = np.abs(motion.w - params.w_d)
    off, turned = np.hypot(error[:, 0], error[:, 1]).max(), error[:, 2].max()
    return {
        "policy": policy,
        "charts": paper_figures.figure_5(motion, state.target, params),
        "time": f"{row['time_s']:.0f}",
        "head": f"moves by at most {off:.1g} m and turns by at most {turned:.1g} rad"
        if max(off, turned) > 1e-9
        else "does not move",
    }


def _constants(params: SnakeParams) -> list[tuple[str, str, bool]]:
    """Every constant: its name, its value, and whether it differs from the paper's."""
    usual = dataclasses.asdict(SnakeParams())
    return [
        (name, constant(value), value != usual[name])
        for name, value in dataclasses.asdict(params).items()
    ]
