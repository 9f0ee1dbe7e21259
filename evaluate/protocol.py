"""How an episode is run and measured, the same for every policy."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from typing import Any

from evaluate.deadline import DecisionTimeoutError, with_timeout
from evaluate.outside import is_outside, make_policy, staying
from harness.console import in_one_line
from snake_env.errors import InvalidInputError, UnknownNameError, as_integer
from snake_env.params import SnakeParams
from snake_env.policies.base import Policy, models_of
from snake_env.policies.skid import skid
from snake_env.sim.episode import Episode, EpisodeSummary
from snake_env.sim.slip import NO_SLIP, Slip, SlipProcess
from snake_env.sim.tasks import TaskSuite
from snake_env.state import SnakeState

SKID = "skid"
"""Not a choice of modes, but evaluated on the same tasks."""


def chooses_modes(policy: str) -> bool:
    """Whether a policy can be compared with the others: skidding does something else.

    A comparison of folders may have added the folder to its name.
    """
    return policy.partition(" (")[0] != SKID


Row = dict[str, Any]
"""An episode as a row of ``episodes.csv``."""

COLUMNS = (
    *("policy", "task"),
    *(field.name for field in dataclasses.fields(EpisodeSummary)),
    *("rollouts", "slip_m", "slip_rad", "modes", "error"),
)
"""The keys of a row."""


_LONGEST_ERROR = 300  # characters: every row carries one
_MOST_ROLLOUTS = 2**53


@dataclass(frozen=True)
class Shard:
    """One policy's episodes on some tasks: the unit of work, the same for any number of workers.

    Attributes:
        policy: The policy's name.
        tasks: Task ids.
        states: Where each begins.
        params: The constants.
        decision_timeout_s: What a decision may take [s]; None: any time.
        slip: How much the wheels slip.
        models: SHA-256 of the policy's model files: the worker then makes the policy once for all
            shards; None: the files may change from shard to shard.
    """

    policy: str
    tasks: list[int]
    states: list[SnakeState]
    params: SnakeParams
    decision_timeout_s: float | None = None
    slip: Slip = NO_SLIP
    models: tuple[str, ...] | None = None

    @classmethod
    def of(
        cls, policy: str, suite: TaskSuite, tasks: list[int], params: SnakeParams, **more: Any
    ) -> Shard:
        """A policy's episodes on some tasks of a suite; ``more`` are further attributes."""
        return cls(policy, tasks, [suite.initial(task, params) for task in tasks], params, **more)


def check_policy(name: str, params: SnakeParams, slip: Slip = NO_SLIP) -> list[str]:
    """Raises what :func:`evaluate.outside.make_policy` would, before any work has been done.

    Returns:
        SHA-256 of each model file that the policy works with.
    """
    if name == SKID:
        if any(slip):
            raise InvalidInputError("slip", slip, f"no slip for {SKID}: it has no intervals")
        return []
    try:
        return _digests(make_policy(name, params))
    except UnknownNameError as error:
        known = [*error.known, SKID] if error.kind == "policy" else error.known
        raise UnknownNameError(error.kind, error.name, known) from None


def run_shard(shard: Shard) -> list[Row]:
    """Runs a shard's episodes in order: one row per task."""
    with staying():
        return _rows_of(shard)


def _digests(policy: Policy) -> list[str]:
    return [model.sha256 for model in models_of(policy) if model.sha256]


def _policy_of(shard: Shard) -> Policy:
    if shard.models is None or is_outside(shard.policy):
        return make_policy(shard.policy, shard.params)
    return _made(shard.policy, shard.params, shard.models)


@functools.lru_cache(maxsize=8)
def _made(name: str, params: SnakeParams, models: tuple[str, ...]) -> Policy:
    policy = make_policy(name, params)
    if tuple(_digests(policy)) != models:
        expected = "the model file that the evaluation began with: it has changed since"
        raise InvalidInputError("policy", name, expected)
    return policy


def _rows_of(shard: Shard) -> list[Row]:
    rows: list[Row] = []
    policy = None if shard.policy == SKID else _policy_of(shard)
    for task, state in zip(shard.tasks, shard.states, strict=True):
        if policy is None:
            summary, _ = skid(state, shard.params)
            row = {
                **dataclasses.asdict(summary),
                "rollouts": 0,
                "slip_m": 0.0,
                "slip_rad": 0.0,
                "modes": "",
                "error": "",
            }
        else:
            limit = shard.decision_timeout_s
            row = run_episode(policy, state, shard.params, task, limit, shard.slip)
        rows.append({"policy": shard.policy, "task": task, **row})
    return rows


def run_episode(
    policy: Policy,
    state: SnakeState,
    params: SnakeParams,
    seed: int,
    decision_timeout_s: float | None = None,
    slip: Slip = NO_SLIP,
) -> Row:
    """Runs one episode.

    Args:
        policy: Chooses the modes.
        state: Where it begins.
        params: The constants.
        seed: The task's id: for slip, and for policies that draw random numbers.
        decision_timeout_s: What a decision may take [s]; None: any time.
        slip: How much the wheels slip.

    Returns:
        The episode's figures. A policy that raises, thinks for too long or chooses a mode that the
        phase does not allow ends it with the outcome ``error``.
    """
    episode = Episode(state, params)
    slip_process = SlipProcess(slip, seed, params)
    modes: list[int] = []
    error = ""
    rollouts_before = 0
    try:
        rollouts_before = _rollouts(policy)
        with_timeout(decision_timeout_s, policy.reset, seed)
        if _rollouts(policy) < rollouts_before:  # it counts each episode by itself
            rollouts_before = 0
        while not episode.outcome:
            mode = with_timeout(decision_timeout_s, policy.select_mode, state)
            after, prediction = slip_process.advance(state, mode)
            if episode.take(state, after, prediction):
                modes.append(mode)
                state = after
    except (Exception, SystemExit, DecisionTimeoutError) as problem:
        episode.end("error")
        error = _message(problem)
    try:
        rollouts = _rollouts(policy) - rollouts_before
        if rollouts < 0:
            raise ValueError(f"rollouts fell by {-rollouts} in the episode")
    except Exception as problem:
        episode.end("error")
        error, rollouts = error or _message(problem), 0
    return {
        **dataclasses.asdict(episode.summary()),
        "rollouts": rollouts,
        "slip_m": slip[0],
        "slip_rad": slip[1],
        "modes": " ".join(map(str, modes)),
        "error": error,
    }


def _rollouts(policy: Policy) -> int:
    rollouts = as_integer(policy.rollouts)
    if rollouts is None or not 0 <= rollouts <= _MOST_ROLLOUTS:
        expected = f"an integer, 0 to {_MOST_ROLLOUTS}"
        raise InvalidInputError("rollouts", policy.rollouts, expected)
    return rollouts


def _message(problem: BaseException) -> str:
    """What went wrong, as a short text that any file can hold and any terminal can show."""
    text = in_one_line(problem)
    return text if len(text) <= _LONGEST_ERROR else f"{text[: _LONGEST_ERROR - 3]}..."
