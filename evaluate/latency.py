"""How long a policy thinks: measured by itself, when the episodes are done.

While episodes run, workers share caches and cores with each other, so what they would measure says as
much about the neighbours as about the policy.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from evaluate.deadline import DecisionTimeoutError, with_timeout
from evaluate.outside import make_policy, staying
from evaluate.protocol import Row, chooses_modes
from evaluate.replay import modes_of, slip_process_of
from snake_env.params import SnakeParams
from snake_env.policies.base import Policy
from snake_env.sim.tasks import TaskSuite
from snake_env.state import SnakeState

DECISIONS = 300
"""Decisions that are measured of each policy ..."""
SECONDS = 20.0
"""... unless they take longer than this [s]."""
TURN = 50
"""Decisions before it is the next policy's turn. Few, so that all meet with the same neighbours; many,
so that a policy finds its networks in the caches, as it does where it works alone."""


def measure_latencies(
    rows: Mapping[str, Sequence[Row]],
    suite: TaskSuite,
    params: SnakeParams,
    decision_timeout_s: float | None = None,
) -> dict[str, list[float]]:
    """Durations of decisions [us] by policy, on one thread, warm, the policies in turns.

    Each policy decides again in the states of its own episodes: in whole episodes, as a planner may
    follow a plan, spread over the suite. Nothing but the decision is timed. The first decision of each
    warms up and does not count.

    Args:
        rows: Each policy's episodes.
        suite: Their tasks.
        params: The constants.
        decision_timeout_s: What a decision may take [s]; None: any time.
    """
    durations: dict[str, list[float]] = {name: [] for name in rows}
    with threadpool_limits(1), staying():
        turns = {
            name: _decide_again(name, own, suite, params, decision_timeout_s)
            for name, own in rows.items()
            if chooses_modes(name)
        }
        while turns:
            for name, decisions in list(turns.items()):
                own = durations[name]
                before = len(own)
                for duration in itertools.islice(decisions, TURN):
                    own.append(duration)
                    if _enough(own):
                        break
                if _enough(own) or len(own) < before + TURN:
                    del turns[name]
    return {name: own[1:] for name, own in durations.items()}


def _enough(durations: Sequence[float]) -> bool:
    return len(durations) > DECISIONS or sum(durations) > 1e6 * SECONDS


def _decide_again(
    name: str, rows: Sequence[Row], suite: TaskSuite, params: SnakeParams, limit_s: float | None
) -> Iterator[float]:
    """Durations of a policy's decisions in the states that its episodes went through [us]."""
    try:
        policy = make_policy(name, params)
        for k in _spread(len(rows)):
            row = rows[k]
            if row["error"]:
                continue
            state = suite.initial(row["task"], params)
            with_timeout(limit_s, policy.reset, row["task"])
            process = slip_process_of(row, params)
            for mode in modes_of(row):
                yield with_timeout(limit_s, _duration_us, policy, state)
                state, _ = process.advance(state, mode)
    except (Exception, SystemExit, DecisionTimeoutError):
        return  # it decided well in the episodes: what is measured so far has to do


def _duration_us(policy: Policy, state: SnakeState) -> float:
    """What one decision takes [us]; inside the timer of the limit, which takes time itself."""
    began = time.perf_counter_ns()
    policy.select_mode(state)
    return round((time.perf_counter_ns() - began) / 1e3, 1)


def _spread(count: int) -> list[int]:
    """Up to DECISIONS positions, spread evenly."""
    positions = np.linspace(0, count - 1, min(count, DECISIONS)).astype(int)
    return sorted(set(positions.tolist()))
