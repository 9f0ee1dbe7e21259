"""Figures of a policy over many episodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from evaluate.protocol import Row
from snake_env.params import SnakeParams

VIOLATIONS = ("stability", "joint_limit", "collision")


def wilson95(successes: int, n: int) -> tuple[float, float]:
    """95 % Wilson interval of a success rate."""
    interval = binomtest(successes, n).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)


def summarise(
    rows: Sequence[Row], latencies_us: Sequence[float], params: SnakeParams
) -> dict[str, Any]:
    """Figures of one policy's episodes; times and costs are of the successful ones.

    Args:
        rows: Its episodes, at least one.
        latencies_us: Durations of decisions [us]; none where they were not measured.
        params: The constants.

    Returns:
        The policy's entry of ``summary.json``; what can't be said is None.
    """
    solved = [row for row in rows if row["outcome"] == "success"]
    failed = [row for row in rows if row["outcome"] != "success"]
    times = [row["time_s"] for row in solved]
    decisions = sum(decisions_of(row, params) for row in rows)
    horizon = params.horizon_s
    cost = _known(row["cost_integral"] for row in solved)
    return {
        "n": len(rows),
        "success": len(solved),
        "success_rate": len(solved) / len(rows),
        "wilson95": list(wilson95(len(solved), len(rows))),
        "time_s": {
            "min": _or_none(np.min, times),
            "median": _or_none(np.median, times),
            "mean": _or_none(np.mean, times),
            "max": _or_none(np.max, times),
        },
        "restricted_mean_time_s": float(
            np.mean([*(min(t, horizon) for t in times), *([horizon] * len(failed))])
        ),
        "cost_integral": _or_none(np.mean, cost),
        "d_min": _or_none(np.min, _known(row["d_min"] for row in rows)),
        "max_abs_phi": _or_none(np.max, [row["max_abs_phi"] for row in rows]),
        "head_error_m": _or_none(np.mean, [row["head_error_m"] for row in rows]),
        "head_error_rad": _or_none(np.mean, [row["head_error_rad"] for row in rows]),
        "violations": sum(row["outcome"] in VIOLATIONS for row in rows),
        "outcomes": dict(sorted(Counter(row["outcome"] for row in rows).items())),
        "failures_by_phase": {
            f"{outcome} in phase {phase}": count
            for (outcome, phase), count in sorted(
                Counter((row["outcome"], row["phase"]) for row in failed).items()
            )
        },
        "rollouts_per_decision": (
            sum(row["rollouts"] for row in rows) / decisions if decisions else None
        ),
        "decision_latency_us": {
            f"p{share}": _or_none(lambda x, share=share: np.percentile(x, share), latencies_us)
            for share in (50, 95, 99)
        },
    }


def decisions_of(row: Row, params: SnakeParams) -> int:
    """How many decisions an episode took: its modes, and the one that found none feasible."""
    modes: str = row["modes"]
    unfeasible = row["outcome"] == "deadlock" and row["intervals"] < params.horizon
    return len(modes.split()) + unfeasible


def _known(values: Any) -> list[float]:
    return [value for value in values if np.isfinite(value)]


def _or_none(statistic: Any, values: Sequence[float]) -> float | None:
    return float(statistic(values)) if len(values) else None
