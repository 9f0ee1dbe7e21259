"""Several trainings of one method, which differ in their seed: how much of a result is luck.

Model files whose paths differ only in the number of ``-s0/``, ``-s1/``, ... belong together: this is
how ``python -m train`` names its runs.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from evaluate.comparison import ALPHA, RESAMPLES, SEED, FloatArray, Interval, Results, differs

# ... but not in the folder that a comparison adds to a name: that is one policy, evaluated twice.
_SEED_OF_RUN = re.compile(r"-s\d+(?=/)(?![^(]*\)$)")


def groups(policies: Iterable[str]) -> dict[str, list[str]]:
    """Policies that differ in their seed alone, by their name with ``-s*`` for the seed."""
    found: dict[str, list[str]] = {}
    for policy in policies:
        if _SEED_OF_RUN.search(policy):
            found.setdefault(_SEED_OF_RUN.sub("-s*", policy), []).append(policy)
    return {name: members for name, members in found.items() if len(members) > 1}


def seed_entries(results: Mapping[str, Results]) -> dict[str, Any]:
    """Sums up each group of seeds: ``seeds`` of ``summary.json``.

    Args:
        results: By policy, all on the same tasks; the first is the reference.
    """
    reference = next(iter(results))
    entries = {}
    for name, members in groups(results).items():
        own = {member: results[member] for member in members}
        entry = _entry(own)
        if reference not in members:
            entry |= _against(reference, results[reference], own)
        entry["sentence"] = _sentence(name, entry, len(results[reference]))
        entries[name] = entry
    return entries


def mean_over_seeds(values: FloatArray) -> Interval | None:
    """Mean over seeds and tasks, with a 95 % bootstrap interval over both.

    Seeds are drawn with replacement, then tasks: the same for all seeds, as all were tried on the same.
    So the interval says what other trainings and other tasks might have given.

    Args:
        values: One value for each seed and task, shape (S, N).

    Returns:
        None where there are fewer than two seeds or tasks.
    """
    seeds, tasks = values.shape
    if seeds < 2 or tasks < 2:
        return None
    rng = np.random.default_rng(SEED)
    means = np.empty(RESAMPLES)
    for k in range(RESAMPLES):
        mean_of_tasks = values[rng.integers(seeds, size=seeds)].mean(axis=0)
        means[k] = mean_of_tasks[rng.integers(tasks, size=tasks)].mean()
    low, high = np.percentile(means, [50 * ALPHA, 100 - 50 * ALPHA])
    return {"mean": float(values.mean()), "low": float(low), "high": float(high)}


def _stacked(results: Mapping[str, Results]) -> tuple[FloatArray, FloatArray]:
    """Successes (0 or 1) and times [s], each of shape (S, N)."""
    solved = np.array([own.solved for own in results.values()], dtype=np.float64)
    return solved, np.array([own.time_s for own in results.values()])


def _entry(results: Mapping[str, Results]) -> dict[str, Any]:
    figures: dict[str, dict[str, Any]] = {
        name: {
            "policy": name,
            "success_rate": float(own.solved.mean()),
            "restricted_mean_time_s": float(own.time_s.mean()),
        }
        for name, own in results.items()
    }
    best_first = sorted(
        figures.values(),
        key=lambda own: (-float(own["success_rate"]), float(own["restricted_mean_time_s"])),
    )
    solved, times = _stacked(results)
    return {
        "policies": list(results),
        "success_rate": mean_over_seeds(solved),
        "restricted_mean_time_s": mean_over_seeds(times),
        "best": best_first[0],
        "median": best_first[len(best_first) // 2],  # of an even number the worse
        "worst": best_first[-1],
    }


def _against(reference: str, first: Results, results: Mapping[str, Results]) -> dict[str, Any]:
    solved, times = _stacked(results)
    return {
        "reference": reference,
        "success_difference": mean_over_seeds(solved - first.solved),
        "restricted_time_difference_s": mean_over_seeds(times - first.time_s),
    }


def _sentence(name: str, entry: Mapping[str, Any], tasks: int) -> str:
    rates = [f"{100 * entry[which]['success_rate']:.2f} %" for which in ("best", "median", "worst")]
    text = (
        f"{len(entry['policies'])} seeds of {name} solve {rates[0]} (best), {rates[1]} (median) and "
        f"{rates[2]} (worst)"
    )
    difference = entry.get("success_difference")
    if difference is None:
        return text
    mean, low, high = (100 * difference[key] for key in ("mean", "low", "high"))
    text += f"; on average {mean:+.2f} points against {entry['reference']}"
    verdict = "" if differs(difference, tasks) else ", no significant difference"
    return f"{text} (95 % CI over seeds and tasks {low:+.2f} to {high:+.2f}{verdict})"
