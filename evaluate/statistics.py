"""Figures of a policy over many episodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from evaluate.protocol import Row
from snake_env.params import SnakeParams

VIOLATIONS = ("stability", "joint_limit", "collision")
_NEEDED = (
    *("outcome", "phase", "time_s", "cost_integral", "d_min", "max_abs_phi"),
    *("head_error_m", "head_error_rad", "shape_error_rad", "rollouts"),
)


def wilson95(successes: int, n: int) -> tuple[float, float]:
    """95 % Wilson interval of a success rate."""
    interval = binomtest(successes, n).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)


def summarise(
    rows: Sequence[Row], latencies_us: Sequence[float], params: SnakeParams
) -> dict[str, Any]:
    """Figures of one policy's episodes; times, costs and shape errors are of the successful ones.

    Args:
        rows: Its episodes, at least one.
        latencies_us: Durations of decisions [us]; none where they were not measured.
        params: The constants.

    Returns:
        The policy's entry of ``summary.json``; what can't be said is None.
    """
    figures = _columns(rows, params)
    outcome, phase = figures["outcome"], figures["phase"]
    solved = outcome == "success"
    times, horizon = figures["time_s"][solved], params.horizon_s
    errors = figures["shape_error_rad"][solved]
    decisions = int(figures["decisions"].sum())
    restricted = np.where(solved, np.minimum(figures["time_s"], horizon), horizon)
    return {
        "name": rows[0]["policy"],
        "n": len(rows),
        "success": int(solved.sum()),
        "success_rate": int(solved.sum()) / len(rows),
        "wilson95": list(wilson95(int(solved.sum()), len(rows))),
        "time_s": {
            "min": _or_none(np.min, times),
            "median": _or_none(np.median, times),
            "mean": _or_none(np.mean, times),
            "max": _or_none(np.max, times),
        },
        "restricted_mean_time_s": float(restricted.mean()),
        "cost_integral": _or_none(np.mean, _known(figures["cost_integral"][solved])),
        "d_min": _or_none(np.min, _known(figures["d_min"])),
        "max_abs_phi": float(figures["max_abs_phi"].max()),
        "head_error_m": float(figures["head_error_m"].mean()),
        "head_error_rad": float(figures["head_error_rad"].mean()),
        "shape_error_rad": {
            "median": _or_none(np.median, errors),
            "p90": _or_none(lambda x: np.percentile(x, 90), errors),
            "max": _or_none(np.max, errors),
        },
        "violations": int(np.isin(outcome, VIOLATIONS).sum()),
        "outcomes": dict(sorted(Counter(outcome.tolist()).items())),
        "failures_by_phase": {
            f"{failure} in phase {where}": count
            for (failure, where), count in sorted(
                Counter(
                    zip(outcome[~solved].tolist(), phase[~solved].tolist(), strict=True)
                ).items()
            )
        },
        "rollouts_per_decision": (
            int(figures["rollouts"].sum()) / decisions if decisions else None
        ),
        "decision_latency_us": {
            f"p{share}": _or_none(lambda x, share=share: np.percentile(x, share), latencies_us)
            for share in (50, 95, 99)
        },
    }


def _columns(rows: Iterable[Row], params: SnakeParams) -> dict[str, NDArray[Any]]:
    """What the figures need of the rows, which may be made one by one."""
    values = [(*(row[name] for name in _NEEDED), decisions_of(row, params)) for row in rows]
    columns = zip(*values, strict=True)
    return {name: np.array(own) for name, own in zip((*_NEEDED, "decisions"), columns, strict=True)}


def decisions_of(row: Row, params: SnakeParams) -> int:
    """How many decisions an episode took: its modes, and the one that found none feasible."""
    modes: str = row["modes"]
    unfeasible = row["outcome"] == "deadlock" and row["intervals"] < params.horizon
    return len(modes.split()) + int(unfeasible)


def _known(values: NDArray[Any]) -> NDArray[Any]:
    known: NDArray[Any] = values[np.isfinite(values)]
    return known


def _or_none(statistic: Any, values: Sequence[float] | NDArray[Any]) -> float | None:
    return float(statistic(values)) if len(values) else None
