"""What ``summary.json`` holds, of a run and of finished runs that are compared."""

from __future__ import annotations

import dataclasses
import os
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

from evaluate.comparison import Results, compare_all, profile
from evaluate.protocol import Row, chooses_modes
from evaluate.seeds import seed_entries
from evaluate.statistics import summarise
from harness.provenance import revision
from snake_env.params import SnakeParams


def build_summary(
    config: Mapping[str, Any],
    rows: Mapping[str, Sequence[Row]],
    latencies: Mapping[str, Sequence[float]],
    params: SnakeParams,
    command: str,
    *,
    complete: bool = True,
) -> dict[str, Any]:
    """Figures of all policies, and of each against the first.

    Args:
        config: ``tasks``, ``preset``, ``params``, ``slip`` and ``models`` are described.
        rows: Each policy's episodes.
        latencies: Durations of decisions by policy [us], where they were measured.
        params: The constants.
        command: What makes these results.
        complete: Whether every policy has finished every task: only then are they compared, but for
            ``skid``, which does something else.
    """
    policies = {
        name: summarise(own, latencies.get(name, ()), params) for name, own in rows.items() if own
    }
    compared = [name for name in rows if chooses_modes(name)] if complete else []
    results = {name: Results.of(rows[name], params.horizon_s) for name in compared}
    return {
        "policies": policies,
        "comparisons": compare_all(results) if results else [],
        "profiles": {name: profile(own) for name, own in results.items()},
        "seeds": seed_entries(results) if results else {},
        **{key: config[key] for key in ("tasks", "preset", "params", "slip", "models")},
        "command": command,
        "git": revision(),
        "versions": {
            "snake-mode-env": version("snake-mode-env"),
            "python": platform.python_version(),
            "numpy": version("numpy"),
        },
        "machine": {"processor": platform.machine(), "cores": os.cpu_count()},
    }


def is_papers(summary: Mapping[str, Any]) -> bool:
    """Whether the paper's figures compare: its constants, and no slip."""
    usual = dataclasses.asdict(SnakeParams())
    return bool(summary["params"] == usual) and not any(summary["slip"])


def unusual(summary: Mapping[str, Any]) -> list[str]:
    """The constants that are not the preset's, and how slippery the ground is."""
    usual, (metres, radians) = SnakeParams.preset(summary["preset"]), summary["slip"]
    parts = [
        f"{name}={value}"
        for name, value in summary["params"].items()
        if value != getattr(usual, name)
    ]
    if metres or radians:
        parts.append(f"slip of {1000.0 * metres:g} mm and {radians:g} rad per interval")
    return parts


def sentences(summary: Mapping[str, Any]) -> list[str]:
    """What the comparisons say."""
    entries = [*summary["comparisons"], *summary["seeds"].values()]
    return [entry["sentence"] for entry in entries]
