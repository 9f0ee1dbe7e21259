"""Which episodes the page replays: typical ones, failures, and where policies disagree most."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from evaluate.protocol import Row, chooses_modes
from snake_env.params import SnakeParams

FAILURES_EACH = 4
"""Most failures of a policy that are shown."""
DISAGREEMENTS = 10


@dataclass(frozen=True)
class Choice:
    """An episode worth a look.

    Attributes:
        task: Its row in the suite.
        group: What kind of episode it is.
        why: What is to be seen.
        left: The policy shown on the left at first.
        right: The policy shown on the right at first.
        of: The policy whose episode it is about.
    """

    task: int
    group: str
    why: str
    left: str
    right: str
    of: str


def choose(
    policies: Sequence[str], rows: Mapping[str, Sequence[Row]], params: SnakeParams
) -> list[Choice]:
    """The median task, the slowest, failures of each policy, and the largest disagreements.

    A task is there once, for the first of these reasons.

    Args:
        policies: The policies in their order; the first is the one that others are compared with.
        rows: Their episodes, by task.
        params: The constants.
    """
    tables = {policy: {row["task"]: row for row in rows[policy]} for policy in policies}
    choosing = mode_choosing(policies)
    chosen: dict[int, Choice] = {}
    for choice in (*_typical(choosing, tables), *_failures(choosing, tables)):
        chosen.setdefault(choice.task, choice)
    return [*chosen.values(), *_disagreements(choosing, tables, params, set(chosen))]


def mode_choosing(policies: Sequence[str]) -> list[str]:
    """The policies that choose modes; all where none does."""
    return [policy for policy in policies if chooses_modes(policy)] or list(policies)


Tables = Mapping[str, Mapping[int, Row]]


def fastest_other(policies: Sequence[str], runs: Mapping[str, Row], than: str) -> str:
    """The policy that solves a task first, ``than`` itself left aside if there is another."""
    others = [policy for policy in policies if policy != than] or [than]
    return min(others, key=lambda p: (runs[p]["outcome"] != "success", runs[p]["time_s"]))


def _typical(policies: Sequence[str], tables: Tables) -> Iterator[Choice]:
    first = policies[0]
    solved = [row for row in tables[first].values() if row["outcome"] == "success"]
    by_time = sorted(solved, key=lambda row: (row["time_s"], row["task"]))
    if not by_time:
        by_time = list(tables[first].values())
    for row, name in ((by_time[(len(by_time) - 1) // 2], "median"), (by_time[-1], "slowest")):
        task = row["task"]
        runs = {policy: tables[policy][task] for policy in policies}
        why = f"{name} task of {first}"
        yield Choice(task, "Typical", why, first, fastest_other(policies, runs, first), first)


def _failures(policies: Sequence[str], tables: Tables) -> Iterator[Choice]:
    for policy in policies:
        failed = [row for row in tables[policy].values() if row["outcome"] != "success"]
        for row in failed[:FAILURES_EACH]:
            cause = row["outcome"].replace("_", " ")
            runs = {other: tables[other][row["task"]] for other in policies}
            better = fastest_other(policies, runs, policy)
            why = f"{policy}: {cause} in phase {row['phase']}"
            sides = _ordered(policies, policy, better)
            yield Choice(row["task"], "Failures", why, *sides, policy)


def _disagreements(
    policies: Sequence[str], tables: Tables, params: SnakeParams, taken: set[int]
) -> Iterator[Choice]:
    """Each policy's largest differences from the first in time, the policies taking turns."""
    first, *others = policies
    most = len(taken) + DISAGREEMENTS
    rankings = {policy: _gaps(tables[policy], tables[first], params) for policy in others}
    while any(rankings.values()):
        for policy, ranking in rankings.items():
            while ranking and ranking[0][0] in taken:
                ranking.pop(0)
            if not ranking:
                continue
            task, gap = ranking.pop(0)
            taken.add(task)
            word = "slower" if gap > 0 else "faster"
            yield Choice(
                task, "Disagreements", f"{policy}: {abs(gap):.0f} s {word}", first, policy, policy
            )
            if len(taken) == most:
                return


def _gaps(
    own: Mapping[int, Row], first: Mapping[int, Row], params: SnakeParams
) -> list[tuple[int, float]]:
    """Tasks with how much longer they take than by the first policy, the largest gap first.

    A failure takes the whole horizon.
    """

    def time_s(row: Row) -> float:
        return float(row["time_s"]) if row["outcome"] == "success" else params.horizon_s

    gaps = [(task, time_s(own[task]) - time_s(first[task])) for task in first]
    return sorted((g for g in gaps if g[1]), key=lambda g: (-abs(g[1]), g[0]))


def _ordered(policies: Sequence[str], one: str, other: str) -> tuple[str, str]:
    """Two policies in the order in which they were named."""
    left, right = sorted((one, other), key=policies.index)
    return left, right
