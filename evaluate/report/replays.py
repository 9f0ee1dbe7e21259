"""The episodes that the page replays, with their data."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from evaluate.protocol import Row, Shard, run_shard
from evaluate.replay import modes_of, slip_of
from evaluate.report.episodes import Choice, choose, fastest_other, mode_choosing
from evaluate.report.motion import (
    QUANTUM,
    encode,
    encode_angles,
    frame_steps,
    motion_of,
    until_still,
)
from snake_env.errors import SnakeEnvError
from snake_env.params import SnakeParams
from snake_env.sim.tasks import TaskSuite, load_tasks
from snake_env.state import SnakeState

BUDGET = 2_500_000
"""Episodes beyond these bytes are left out: ten policies on 10,000 tasks then stay below 5 MB."""
SIM_1 = "sim-1"


@dataclass(frozen=True, eq=False)
class Replayed:
    """An episode of every policy.

    Attributes:
        name: The task: ``sim-1``, or its number.
        choice: Why it is here, and which policies are shown first.
        state: Where it begins.
        rows: How it went, by policy.
    """

    name: str
    choice: Choice
    state: SnakeState
    rows: Mapping[str, Row]


def sim_1(
    rows: Mapping[str, Sequence[Row]],
    params: SnakeParams,
    suite: TaskSuite,
    decision_timeout_s: float | None = None,
) -> list[Replayed]:
    """The paper's first simulation by every policy of ``rows``, with the same slip.

    There is none if it is among the tasks, if this robot can't have its shapes, or if a policy is not
    at hand any more: results may be older than the file that it came from.
    """
    if suite.name == SIM_1:
        return []
    try:
        state = load_tasks(SIM_1, params).initial(0, params)
        played = {
            policy: run_shard(
                Shard(policy, [0], [state], params, decision_timeout_s, slip_of(own[0]))
            )[0]
            for policy, own in rows.items()
        }
    except SnakeEnvError:
        return []
    choosing = mode_choosing(list(rows))
    choice = Choice(
        task=0,
        group="Typical",
        why="simulation 1 of the paper, not among these tasks",
        left=choosing[0],
        right=fastest_other(choosing, played, choosing[0]),
        of=choosing[0],
    )
    return [Replayed(SIM_1, choice, state, played)]


def collect(
    policies: Sequence[str],
    rows: Mapping[str, Sequence[Row]],
    params: SnakeParams,
    suite: TaskSuite,
) -> list[Replayed]:
    """The episodes of the suite that are worth a look."""
    by_task = {policy: {row["task"]: row for row in rows[policy]} for policy in policies}
    return [
        Replayed(
            name=f"task {choice.task}",
            choice=choice,
            state=suite.initial(choice.task, params),
            rows={policy: by_task[policy][choice.task] for policy in policies},
        )
        for choice in choose(policies, rows, params)
    ]


def data(
    policies: Sequence[str], episodes: Iterable[Replayed], params: SnakeParams
) -> dict[str, Any]:
    """What ``player.js`` gets: robot, policies, and as many episodes as :data:`BUDGET` allows."""
    room = BUDGET
    kept: list[dict[str, Any]] = []
    for episode in episodes:
        entry = _episode(policies, episode, params)
        room -= len(json.dumps(entry))
        if room < 0 and kept:
            break
        kept.append(entry)
    names = ("n_joints", "l", "track", "head_contact", "phi_limit", "u_limit", "w_d", "delta_t")
    constants = dataclasses.asdict(params)
    robot = {name: constants[name] for name in names}
    robot |= {"frame_s": frame_steps(params) * params.dt, "quantum": QUANTUM}
    return {"robot": robot, "policies": list(policies), "episodes": kept}


def _episode(policies: Sequence[str], episode: Replayed, params: SnakeParams) -> dict[str, Any]:
    choice = episode.choice
    return {
        "name": episode.name,
        "group": choice.group,
        "why": choice.why,
        "left": policies.index(choice.left),
        "right": policies.index(choice.right),
        "of": policies.index(choice.of),
        "target": encode_angles(episode.state.target),
        "runs": [_run(episode.rows[policy], episode.state, params) for policy in policies],
    }


def _run(row: Row, state: SnakeState, params: SnakeParams) -> dict[str, Any]:
    motion = motion_of(row, state, params)
    if row["outcome"] == "deadlock":
        motion = until_still(motion, params)
    ending = {"outcome": row["outcome"], "phase": row["phase"], "error": row["error"]}
    return {
        **ending,
        "time": row["time_s"],
        "modes": modes_of(row)[: len(motion.phases)],
        **encode(motion, params),
    }
