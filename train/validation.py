"""How good a policy is while it learns: the evaluation's protocol on tasks for choosing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluate.protocol import Shard, run_shard
from evaluate.statistics import summarise
from snake_env.errors import InvalidInputError
from snake_env.params import SnakeParams
from snake_env.policies.registry import CRITIC
from snake_env.sim.slip import NO_SLIP, Slip
from snake_env.sim.tasks import FROZEN, load_tasks

SUITE = "validation-2k"


def check_count(field: str, count: int) -> None:
    """Raises InvalidInputError unless the suite has ``count`` tasks."""
    most = FROZEN[SUITE][0]
    if not 1 <= count <= most:
        raise InvalidInputError(field, count, f"1 to {most}")


@dataclass(frozen=True)
class Validation:
    """How a policy is validated while it learns."""

    validation_tasks: int = 500
    """Number of validation-2k tasks per validation, raw and with +critic."""

    def check(self) -> None:
        """Raises InvalidInputError where the number can't be used."""
        check_count("validation_tasks", self.validation_tasks)

    def __call__(self, model: Path, params: SnakeParams, slip: Slip = NO_SLIP) -> dict[str, float]:
        """Success rate, mean time and roll-outs per decision, raw and with the critic."""
        suite = load_tasks(SUITE, params)
        tasks = list(range(self.validation_tasks))
        figures: dict[str, float] = {}
        for label, policy in (("raw", str(model)), ("critic", f"{model}{CRITIC}")):
            rows = run_shard(Shard.of(policy, suite, tasks, params, slip=slip))
            summary: dict[str, Any] = summarise(rows, (), params)
            figures[f"{label}_success"] = round(summary["success_rate"], 5)
            figures[f"{label}_time_s"] = round(summary["time_s"]["mean"] or float("nan"), 3)
            figures[f"{label}_restricted_time_s"] = round(summary["restricted_mean_time_s"], 3)
            figures[f"{label}_rollouts"] = round(summary["rollouts_per_decision"] or 0.0, 4)
        return figures


def in_words(row: dict[str, Any]) -> str:
    """A validation in words."""
    parts = []
    for label, name in (("raw", "raw"), ("critic", "+critic")):
        time_s = float(row[f"{label}_time_s"])
        mean = f" in {time_s:.1f} s" if time_s == time_s else ""  # not a number: nothing was solved
        parts.append(f"{name} {float(row[f'{label}_success']):.1%}{mean}")
    return ", ".join(parts)


def quality(row: dict[str, Any]) -> tuple[float, float]:
    """By what the best is kept: success of the raw policy, then its time (less is better)."""
    time_s = float(row["raw_time_s"])
    return float(row["raw_success"]), -time_s if time_s == time_s else float("-inf")
