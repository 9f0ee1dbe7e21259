"""What the page says first: the most important effect, then all comparisons, each in a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from evaluate.comparison import ALPHA, differs
from evaluate.report.charts import Entry
from evaluate.report.formats import interval, number


def headline(entries: Sequence[Entry], summary: Mapping[str, Any]) -> str:
    """The comparison with the largest significant effect, with what a decision costs.

    Success counts first, then time. Without comparisons: how the first policy does.
    """
    comparisons = summary.get("comparisons") or []
    if not comparisons:
        return _alone(entries[0])
    largest = max(comparisons, key=_effect)
    figures = {entry.name: entry.figures for entry in entries}
    own, first = (figures[largest[who]]["rollouts_per_decision"] for who in ("policy", "reference"))
    text: str = largest["sentence"]
    if own is not None and first is not None:
        text += f", with {number(own)} roll-outs per decision against {number(first)}"
    return f"{text}."


def findings(summary: Mapping[str, Any]) -> list[str]:
    """All comparisons with the first policy, and what the seeds of a method differ by."""
    seeds = (summary.get("seeds") or {}).values()
    return [f"{entry['sentence']}." for entry in (*(summary.get("comparisons") or []), *seeds)]


def _effect(comparison: Mapping[str, Any]) -> tuple[float, float]:
    """Significant effects of a comparison: tasks more, then seconds less; what is worse comes last."""
    tasks = comparison["only_policy"] - comparison["only_reference"]
    significant = comparison["mcnemar_p_holm"] < ALPHA
    time = comparison["time_difference_s"]
    sooner = -time["mean"] if differs(time, comparison["common"]) else 0.0
    return tasks if significant else 0.0, sooner


def _alone(entry: Entry) -> str:
    """How one policy does."""
    figures = entry.figures
    text = (
        f"{entry.name} solves {figures['success']:,} of {figures['n']:,} tasks "
        f"(95 % CI {interval(figures['wilson95'])} %)"
    )
    if figures["time_s"]["median"] is not None:
        text += f", half of them within {figures['time_s']['median']:.0f} s"
    cost = figures["rollouts_per_decision"]
    return text + (f", with {number(cost)} roll-outs per decision." if cost is not None else ".")
