"""Policies against each other on the same tasks: tests, intervals, and what they say in words.

Everything here is a function of episodes' rows. A failure takes the whole horizon, wherever times of
failed episodes are compared; an interval is None where fewer than two tasks say anything about it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, bootstrap, wilcoxon

from evaluate.protocol import Row

FloatArray = NDArray[np.float64]

Interval = dict[str, float]
"""An estimate, ``mean``, and its 95 % interval, ``low`` to ``high``."""

RESAMPLES = 2000
ALPHA = 0.05
SEED = 0
LEAST_TASKS = 20
"""Of fewer tasks a percentile interval is too narrow: with six tasks and skewed differences of mean 0,
it leaves 0 out in a fifth of all cases."""
_BATCH = 2_000_000  # resampled values that are in memory at once


@dataclass(frozen=True)
class Results:
    """How one policy did on N tasks, task by task.

    Attributes:
        solved: Whether it succeeded, shape (N,).
        time_s: Duration, the horizon where it failed, shape (N,) [s].
        cost: Integral of V, shape (N,) [s]; NaN where there is none.
    """

    solved: NDArray[np.bool_]
    time_s: FloatArray
    cost: FloatArray

    @classmethod
    def of(cls, rows: Iterable[Row], horizon_s: float) -> Results:
        """The results in a policy's rows, which are in the order of the tasks."""
        columns = [
            (row["outcome"] == "success", row["time_s"], row["cost_integral"]) for row in rows
        ]
        solved, time_s, cost = np.array(columns, dtype=np.float64).reshape(-1, 3).T
        succeeded = solved == 1.0
        restricted = np.where(succeeded, np.minimum(time_s, horizon_s), horizon_s)
        return cls(succeeded, restricted, cost)

    def __len__(self) -> int:
        return len(self.solved)


def compare_all(results: Mapping[str, Results]) -> list[dict[str, Any]]:
    """Compares every policy with the first: ``comparisons`` of ``summary.json``.

    P-values are corrected for the number of comparisons by Holm's method.

    Args:
        results: By policy, all on the same tasks.
    """
    (reference, first), *others = results.items()
    entries = [compare(reference, first, name, own) for name, own in others]
    for key in ("mcnemar_p", "wilcoxon_p"):
        known = [entry for entry in entries if entry[key] is not None]
        for entry, p in zip(known, holm([entry[key] for entry in known]), strict=True):
            entry[f"{key}_holm"] = p
    for entry in entries:
        entry["sentence"] = sentence(entry, corrected=len(entries) > 1)
    return entries


def compare(reference: str, first: Results, policy: str, second: Results) -> dict[str, Any]:
    """Compares a policy with the reference on the same tasks.

    Args:
        reference: Name of the reference.
        first: Its results on N tasks.
        policy: Name of the policy.
        second: Its results on the same tasks.

    Returns:
        The figures that ``docs/metrics.md`` explains; differences are the policy's value less the
        reference's.
    """
    only_first = int(np.sum(first.solved & ~second.solved))
    only_second = int(np.sum(second.solved & ~first.solved))
    successes = int(first.solved.sum()), int(second.solved.sum())
    common = first.solved & second.solved
    faster = 0.5 + 0.5 * np.sign(first.time_s - second.time_s)
    priced = common & np.isfinite(first.cost) & np.isfinite(second.cost)
    times = first.time_s[common], second.time_s[common]
    success_p, time_p = mcnemar(only_first, only_second), signed_rank(times[1] - times[0])
    return {
        "reference": reference,
        "policy": policy,
        "n": len(first),
        "success_reference": successes[0],
        "success_policy": successes[1],
        "only_reference": only_first,
        "only_policy": only_second,
        "success_difference": (only_second - only_first) / len(first),
        "mcnemar_p": success_p,
        "mcnemar_p_holm": success_p,  # corrected where there are several policies
        "common": int(common.sum()),
        "time_difference_s": mean_interval(times[1] - times[0]),
        "time_ratio": bootstrap_interval(_ratio, *times) if np.any(times[0]) else None,
        "cost_difference": mean_interval(second.cost[priced] - first.cost[priced]),
        "restricted_time_difference_s": mean_interval(second.time_s - first.time_s),
        "wilcoxon_p": time_p,
        "wilcoxon_p_holm": time_p,
        "probability_of_improvement": mean_interval(faster),
    }


def _ratio(first: FloatArray, second: FloatArray, axis: int = -1) -> Any:
    return second.mean(axis=axis) / first.mean(axis=axis)


def mcnemar(only_first: int, only_second: int) -> float:
    """Exact p-value of McNemar's test from the tasks that only one of two policies solves."""
    discordant = only_first + only_second
    return float(binomtest(only_first, discordant, 0.5).pvalue) if discordant else 1.0


def signed_rank(differences: FloatArray) -> float | None:
    """P-value of Wilcoxon's signed-rank test; None where nothing differs.

    Tasks without a difference are left out here, not by SciPy: beside one of them it takes the normal
    approximation however few the others are, and calls five of five significant.
    """
    differing = differences[differences != 0.0]
    return float(wilcoxon(differing).pvalue) if len(differing) else None


def holm(p_values: list[float]) -> list[float]:
    """P-values corrected by Holm's method for being as many."""
    order = np.argsort(p_values)
    factors = np.arange(len(p_values), 0, -1)
    corrected = np.minimum(np.maximum.accumulate(factors * np.array(p_values)[order]), 1.0)
    in_place = np.empty(len(p_values))
    in_place[order] = corrected
    return in_place.tolist()


def mean_interval(values: FloatArray) -> Interval | None:
    """Mean of one value per task with its bootstrap interval."""
    return bootstrap_interval(np.mean, values)


def bootstrap_interval(statistic: Callable[..., Any], *samples: FloatArray) -> Interval | None:
    """A statistic with its 95 % percentile interval over resampled tasks.

    Percentiles need no jackknife, whose cost grows with the square of the number of tasks, and are
    defined where all values are equal.

    Args:
        statistic: Called with the samples and ``axis``.
        *samples: Values of the same N tasks, each of shape (N,).
    """
    count = len(samples[0])
    if count < 2:
        return None
    spread = bootstrap(
        samples,
        statistic,
        paired=True,
        vectorized=True,
        n_resamples=RESAMPLES,
        batch=max(1, _BATCH // count),
        method="percentile",
        rng=np.random.default_rng(SEED),
    ).confidence_interval
    return {
        "mean": float(statistic(*samples, axis=-1)),
        "low": float(spread.low),
        "high": float(spread.high),
    }


def profile(results: Results) -> dict[str, list[float]]:
    """Performance profile: the share of all tasks that are solved within each time that occurs."""
    times, counts = np.unique(results.time_s[results.solved], return_counts=True)
    return {"time_s": times.tolist(), "share": (np.cumsum(counts) / len(results)).tolist()}


def sentence(entry: Mapping[str, Any], *, corrected: bool) -> str:
    """A comparison in words: each difference with the figures that decide whether it is significant.

    In success it is where McNemar's p is below 0.05; in time where the 95 % interval of the mean
    difference, which is shown, excludes 0. Other figures of the entry do not count.

    Args:
        entry: What :func:`compare` gave.
        corrected: Whether its p-values are corrected for further comparisons.
    """
    method = " after Holm" if corrected else ""
    return f"{entry['policy']} {_success_clause(entry, method)}; {_time_clause(entry)}"


def _success_clause(entry: Mapping[str, Any], method: str) -> str:
    reference, n = entry["reference"], entry["n"]
    own, others = entry["success_policy"], entry["success_reference"]
    solved = f"solves {own:,} of {n:,} tasks"
    if entry["only_reference"] == entry["only_policy"] == 0:
        return f"{solved}, the same as {reference}"
    p = _p_value(entry["mcnemar_p_holm"])
    significant = entry["mcnemar_p_holm"] < ALPHA
    verdict = "" if significant else "no significant difference, "
    return f"{solved}, {reference} {others:,} ({verdict}{p}{method})"


def _time_clause(entry: Mapping[str, Any]) -> str:
    common, difference = entry["common"], entry["time_difference_s"]
    if common == 0:
        return "no task is solved by both"
    where = f"on the {common:,} tasks that both solve" if common > 1 else "on the one both solve"
    if entry["wilcoxon_p"] is None:
        return f"as fast {where}"
    if difference is None or common < LEAST_TASKS:
        return f"no significant difference in time {where}"
    mean, low, high = (difference[key] for key in ("mean", "low", "high"))
    if differs(difference, common):
        more = "slower" if low > 0 else "faster"
        least, most = sorted((abs(low), abs(high)))
        span = f"{_seconds(least)} to {_seconds(most)} s"
        return f"{_seconds(abs(mean))} s {more} {where} (95 % CI {span})"
    span = f"{low:+.1f} to {high:+.1f} s"
    return f"no significant difference in time {where} ({mean:+.1f} s, 95 % CI {span})"


def differs(interval: Interval | None, tasks: int) -> bool:
    """Whether a difference is significant: its interval excludes 0, and comes of enough tasks."""
    if interval is None or tasks < LEAST_TASKS:
        return False
    return interval["low"] > 0.0 or interval["high"] < 0.0


def _seconds(time_s: float) -> str:
    """A time that is not 0, so that it does not look like it."""
    return f"{time_s:.1f}" if time_s >= 0.05 else f"{time_s:.1g}"


def _p_value(p: float) -> str:
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}"
