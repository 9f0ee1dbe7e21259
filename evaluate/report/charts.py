"""Charts that compare policies: success, time, and what a decision costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from evaluate.protocol import Row
from evaluate.report.axes import corners, percent_ticks, titled_y_axis
from evaluate.report.svg import (
    WIDTH,
    Scale,
    arrow,
    drawing,
    labelled,
    line,
    linear,
    log_from_zero,
    logarithmic,
    marker,
    round_ticks,
    tag,
    whisker,
    x_axis,
)

_ROW = 30.0  # height of a policy's row
_NAME = 128.0  # where rows begin: names stand before
_CLOSE_TO_ALL = 0.9  # a success rate from which policies are distinguished on the axis
_PAPER_LATENCY_MS = 150.0  # section VI: the longest that (21) took in phase 1


@dataclass(frozen=True)
class Entry:
    """A policy in the charts.

    Attributes:
        name: Its name.
        style: Number of its colour and marker.
        figures: Its entry of ``summary.json``.
        ratio: Its ``mean`` time over the first policy's on the tasks that both solve, with ``low`` and
            ``high`` where an interval is known; None if there is no such task.
    """

    name: str
    style: int
    figures: Mapping[str, Any]
    ratio: Mapping[str, float] | None


def short(name: str, room: int = 18) -> str:
    """A name that fits into ``room`` letters; of a file's path the end matters."""
    return name if len(name) <= room else "\u2026" + name[1 - room :]


def success_chart(entries: Sequence[Entry], paper: tuple[float, float, float] | None) -> Markup:
    """Success rates with their Wilson intervals, a row for each policy.

    Args:
        entries: The policies.
        paper: The paper's rate and its interval, where it compares.
    """
    low = _lowest(entries, paper)
    right = WIDTH - 58.0
    scale = linear(low, 100.0, _NAME, right)
    rows = len(entries) + (paper is not None)
    bottom = 8.0 + _ROW * rows
    parts = [*x_axis(scale, percent_ticks(low), 4.0, bottom, "tasks solved [%]")]
    if paper is not None:
        rate, *interval = (100.0 * share for share in paper)
        parts += _quoted(scale, rate, interval, 8.0 + 0.5 * _ROW)
    for k, entry in enumerate(entries, start=int(paper is not None)):
        figures, y = entry.figures, 8.0 + _ROW * (k + 0.5)
        rate = 100.0 * figures["success_rate"]
        bounds = [100.0 * bound for bound in figures["wilson95"]]
        parts.append(_row_name(entry.name, y))
        parts.append(tag("text", f"{rate:.1f}", x=right + 10, y=y + 4, class_="value"))
        title = f"{entry.name}: {rate:.1f} %, 95 % {bounds[0]:.1f} to {bounds[1]:.1f} %"
        if rate < low:
            parts.append(arrow(_NAME, y, entry.style, title))
            continue
        parts.append(whisker(scale(max(low, bounds[0])), y, scale(bounds[1]), y, entry.style))
        parts.append(marker(scale(rate), y, entry.style, title))
    return drawing("Success rate of each policy with its 95 % Wilson interval", bottom + 40, parts)


def ratio_chart(entries: Sequence[Entry]) -> Markup:
    """Mean time of each policy over the first's on the tasks that both solve."""
    low, high = _ratio_range(entries)
    right = WIDTH - 58.0
    scale = linear(low, high, _NAME, right)
    bottom = 8.0 + _ROW * len(entries)
    title = f"mean time against {entries[0].name}'s"
    parts = [*x_axis(scale, labelled(round_ticks(low, high, 4)), 4.0, bottom, short(title, 44))]
    parts.append(tag("line", x1=scale(1.0), x2=scale(1.0), y1=4.0, y2=bottom, class_="limit"))
    for k, entry in enumerate(entries):
        y = 8.0 + _ROW * (k + 0.5)
        parts.append(_row_name(entry.name, y))
        if entry.ratio is None:
            continue
        mean, text = entry.ratio["mean"], f"{entry.name}: {entry.ratio['mean']:.3f}"
        parts.append(tag("text", f"{mean:.3f}", x=right + 10, y=y + 4, class_="value"))
        if mean > high:
            parts.append(arrow(right, y, entry.style, text, turn=180))
            continue
        if "low" in entry.ratio:
            lower, upper = entry.ratio["low"], entry.ratio["high"]
            parts.append(whisker(scale(lower), y, scale(min(high, upper)), y, entry.style))
            text += f", 95 % {lower:.3f} to {upper:.3f}"
        parts.append(marker(scale(mean), y, entry.style, text))
    return drawing(title, bottom + 40, parts)


def time_cost_chart(entries: Sequence[Entry]) -> Markup:
    """The same ratio against the model roll-outs that a decision costs."""
    known = [entry for entry in _with_rollouts(entries) if entry.ratio is not None]
    low, high = _ratio_range(known)
    scale, axis = _rollouts_axis(known)
    y_scale = linear(low, high, 204.0, 28.0)
    parts = [
        *axis,
        *titled_y_axis(y_scale, labelled(round_ticks(low, high, 4)), "mean time, ratio"),
    ]
    for entry in known:
        ratio = entry.ratio or {}
        mean, x = ratio["mean"], scale(entry.figures["rollouts_per_decision"])
        text = f"{entry.name}: {mean:.3f}"
        if mean > high:
            parts.append(arrow(x, 30.0, entry.style, text, turn=90, label=f"{mean:.2f}"))
            continue
        if "low" in ratio:
            ends = y_scale(ratio["low"]), y_scale(min(high, ratio["high"]))
            parts.append(whisker(x, ends[0], x, ends[1], entry.style))
        parts.append(marker(x, y_scale(mean), entry.style, text))
    return drawing("Mean time against model roll-outs per decision", 250.0, parts)


def _ratio_range(entries: Sequence[Entry]) -> tuple[float, float]:
    """An axis for ratios of times; policies that mostly fail may lie beyond it."""
    near = [e for e in entries if e.ratio and e.figures["success_rate"] >= _CLOSE_TO_ALL]
    shown = near if len(near) > 1 else [entry for entry in entries if entry.ratio]
    values = [1.0, *(value for entry in shown for value in (entry.ratio or {}).values())]
    margin = 0.1 * (max(values) - min(values)) + 0.01
    return min(values) - margin, max(values) + margin


def profile_chart(entries: Sequence[Entry], rows: Mapping[str, Sequence[Row]]) -> Markup:
    """Share of the tasks that each policy has solved within a time."""
    times = {
        entry.name: sorted(row["time_s"] for row in rows[entry.name] if row["outcome"] == "success")
        for entry in entries
    }
    seen = [max(time, 1e-3) for own in times.values() for time in own] or [1.0]
    low, high = 0.95 * min(seen), 1.05 * max(seen)
    x_scale = logarithmic(low, high, 48.0, WIDTH - 18.0)
    y_scale = linear(0.0, 100.0, 234.0, 28.0)
    ticks = [t for t in (0.1, 0.3, 1, 3, 10, 20, 30, 40, 60, 100, 150, 200, 300, 600, 1000)
             if low <= t <= high]  # fmt: skip
    parts = [
        *x_axis(x_scale, labelled(ticks), 28.0, 234.0, "time [s]"),
        *titled_y_axis(y_scale, labelled((0, 25, 50, 75, 100)), "tasks solved [%]"),
    ]
    for entry in reversed(entries):  # the first is drawn last, on top
        count = len(rows[entry.name])
        solved = [(low, 0.0)]
        for k, time in enumerate(times[entry.name]):
            solved += [(max(time, 1e-3), 100.0 * share / count) for share in (k, k + 1)]
        solved.append((high, solved[-1][1]))
        points = [(x_scale(t), y_scale(share)) for t, share in corners(solved)]
        parts.append(line(points, "curve", entry.style))
    return drawing("Share of tasks solved within a time, per policy", 274.0, parts)


def rollouts_chart(entries: Sequence[Entry]) -> Markup:
    """Success against the model roll-outs that a decision costs."""
    known = _with_rollouts(entries)
    scale, axis = _rollouts_axis(known)
    places = [(entry, scale(entry.figures["rollouts_per_decision"])) for entry in known]
    return _cost("Success against model roll-outs per decision", places, axis)


def _with_rollouts(entries: Sequence[Entry]) -> list[Entry]:
    return [entry for entry in entries if entry.figures["rollouts_per_decision"] is not None]


def _rollouts_axis(entries: Sequence[Entry]) -> tuple[Scale, list[Markup]]:
    most = 1.3 * max([100.0, *(entry.figures["rollouts_per_decision"] for entry in entries)])
    scale = log_from_zero(most, 48.0, WIDTH - 18.0)
    ticks = labelled(value for value in (0, 1, 10, 100, 1000, 10_000) if value <= most)
    return scale, x_axis(scale, ticks, 28.0, 210.0, "model roll-outs per decision")


def latency_chart(entries: Sequence[Entry], paper: bool) -> Markup:
    """Success against the 95th percentile of the time that a decision takes.

    The median would flatter a planner, which searches once and then follows its plan.

    Args:
        entries: The policies.
        paper: Whether to mark the paper's 0.15 s.
    """
    known = [e for e in entries if e.figures["decision_latency_us"]["p95"] is not None]
    tails = {entry.name: _latency_ms(entry, "p95") for entry in known}
    times = [*tails.values(), *([_PAPER_LATENCY_MS] if paper else [])] or [1.0]
    low, high = 0.6 * min(times), 1.7 * max(times)
    scale = logarithmic(low, high, 48.0, WIDTH - 18.0)
    powers = [10.0**k for k in range(-3, 6)]
    axis = x_axis(
        scale,
        labelled(p for p in powers if low <= p <= high),
        *(28.0, 210.0, "time per decision [ms], 95th percentile"),
    )
    if paper:
        x = scale(_PAPER_LATENCY_MS)
        axis.append(tag("line", x1=x, x2=x, y1=28.0, y2=210.0, class_="limit"))
        axis.append(tag("text", "paper 0.15 s", x=x - 5, y=204.0, text_anchor="end"))
    places = [(entry, scale(tails[entry.name])) for entry in known]
    return _cost("Success against time per decision", places, axis)


def _cost(title: str, places: Sequence[tuple[Entry, float]], axis: list[Markup]) -> Markup:
    """Success rates with Wilson intervals at given places along an axis."""
    low = _lowest([entry for entry, _ in places], None)
    y_scale = linear(low, 100.0, 204.0, 28.0)
    parts = [*axis, *titled_y_axis(y_scale, percent_ticks(low), "tasks solved [%]")]
    for entry, x in places:
        figures = entry.figures
        rate = 100.0 * figures["success_rate"]
        bottom, top = (100.0 * bound for bound in figures["wilson95"])
        text = f"{entry.name}: {rate:.1f} %"
        if rate < low:
            parts.append(arrow(x, 202.0, entry.style, text, turn=-90, label=f"{rate:.0f} %"))
            continue
        y = y_scale(rate)
        parts.append(whisker(x, y_scale(max(low, bottom)), x, y_scale(top), entry.style))
        parts.append(marker(x, y, entry.style, text))
    return drawing(title, 250.0, parts)


def _lowest(entries: Sequence[Entry], paper: tuple[float, float, float] | None) -> float:
    """Where an axis of success rates [%] begins: policies that nearly always succeed decide."""
    rates = [entry.figures["success_rate"] for entry in entries]
    near = [rate >= _CLOSE_TO_ALL for rate in rates]
    bounds = [
        entry.figures["wilson95"][0]
        for entry, close in zip(entries, near, strict=True)
        if close or not any(near)
    ]
    if paper is not None:
        bounds.append(paper[1])
    lowest = 100.0 * min(bounds, default=0.0)
    return max(0.0, lowest - 0.15 * (100.0 - lowest))


def _latency_ms(entry: Entry, which: str) -> float:
    """A percentile of the time per decision; at least a microsecond, for the logarithm's sake."""
    return float(max(entry.figures["decision_latency_us"][which], 1.0)) / 1e3


def _row_name(name: str, y: float) -> Markup:
    return tag(
        "text", tag("title", name), short(name), x=_NAME - 12, y=y + 4, text_anchor="end",
        class_="name",
    )  # fmt: skip


def _quoted(scale: Scale, rate: float, interval: Sequence[float], y: float) -> list[Markup]:
    """The paper's rate, hollow and grey."""
    x0, x1 = (scale(bound) for bound in interval)
    return [
        tag("text", "the paper", x=_NAME - 12, y=y + 4, text_anchor="end", class_="quoted"),
        tag("line", x1=x0, x2=x1, y1=y, y2=y, class_="whisker quoted"),
        tag("circle", cx=scale(rate), cy=y, r=4.0, class_="quoted"),
        tag("text", f"{rate:.1f}", x=WIDTH - 48.0, y=y + 4, class_="value quoted"),
    ]
