"""Teachers: what every feasible mode of a state would cost, and states worth asking about."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agents.failures import failure_cost
from agents.labels import Decisions, join
from agents.sampling import sampled_modes
from snake_env.modes import mode_table
from snake_env.networks.network import Network
from snake_env.networks.symmetry import SymmetricNetwork
from snake_env.params import SnakeParams
from snake_env.policies.search import expand
from snake_env.policies.value import ValueFunction, network_value
from snake_env.sim.episode import STILL
from snake_env.sim.masks import action_masks
from snake_env.sim.observation import observe
from snake_env.sim.simulation import advance_batch, predict_batch, successors
from snake_env.sim.slip import NO_SLIP, Slip, randomised_slips, slip_batch
from snake_env.sim.tasks import random_tasks
from snake_env.state import FloatArray, IntArray, StateBatch

FEW = 3
"""A state with at most this many feasible modes is near a deadlock."""
_SIDE_BY_SIDE = 64  # episodes
_LONGEST = 4 / 3  # times the cost of a failure: longer episodes are abandoned
_NOISE = 2.0  # largest scale of the noise in the teacher's choices [intervals]


def label(
    states: StateBatch,
    value: ValueFunction,
    params: SnakeParams,
    modes: NDArray[np.bool_] | None = None,
) -> Decisions:
    """What modes of some states would cost: the mode itself, and what its end is worth.

    Args:
        states: N states that have not reached their target.
        value: What ends are worth.
        params: The constants.
        modes: Which valid modes are asked about, shape (N, n_modes); None: all.
    """
    tree = expand(states, params, modes)
    after = np.clip(value(tree.states), 0.0, failure_cost(params))
    shape = (len(states), len(mode_table(params.n_joints)))
    cost = np.full(shape, np.inf, dtype=np.float32)
    cost[tree.parent, tree.mode] = 1.0 + after
    mask = action_masks(states, params)
    return Decisions(states, mask if modes is None else mask & modes, np.isfinite(cost), cost)


@dataclass(frozen=True, eq=False)
class Visit:
    """A shard of decisions to collect.

    Attributes:
        seed: The collection's seed.
        part: The shard's number.
        decisions: How many.
        value: The network that says what ends are worth.
        student: Whose states are visited: a network that prefers modes; None: the teacher's own, with
            noise in its choices.
        oversampling: How many times as often as others those states are kept in which the student's
            choice is infeasible or, without a student, those near a deadlock.
        params: The constants.
        slip: How much the wheels slip; each episode by its own share of it, from 0 to 2.
    """

    seed: int
    part: int
    decisions: int
    value: Network
    student: Network | None
    oversampling: float
    params: SnakeParams
    slip: Slip = NO_SLIP


def collect(shard: Visit) -> tuple[int, Decisions]:
    """The shard's number, and its decisions: episodes are played until there are enough.

    States in which the phase allows a single mode are no decisions.
    """
    kept: list[Decisions] = []
    wave, missing = 0, shard.decisions
    per_kept = 1.0 if shard.student is None else shard.oversampling
    while missing > 0:
        stream = np.random.SeedSequence(shard.seed, spawn_key=(shard.part, wave, 0))
        count = int(per_kept * min(_SIDE_BY_SIDE, max(1.0, missing / 10)))  # few are cut short
        for decisions in _episodes(shard, count, np.random.default_rng(stream)):
            kept.append(decisions.take(np.arange(min(missing, len(decisions)))))
            missing -= len(kept[-1])
            if missing == 0:
                break
        wave += 1
    return shard.part, join(kept)


def _episodes(shard: Visit, count: int, rng: np.random.Generator) -> Iterator[Decisions]:
    """The decisions of some episodes that are played side by side, interval by interval.

    Robots that come to stand still have nothing more to teach.
    """
    params = shard.params
    phi0, target = random_tasks(rng.spawn(count), params)
    states = StateBatch.initial(phi0, target, params)
    # Half of the episodes follow the teacher strictly, the others less and less.
    scale = np.maximum(rng.uniform(-1.0, 1.0, count), 0.0) * _NOISE
    scales = randomised_slips(shard.slip, count, rng)
    student = None if shard.student is None else SymmetricNetwork(shard.student, params.n_joints)
    for _ in range(round(_LONGEST * failure_cost(params))):
        if student is None:
            decisions, after = _of_teacher(states, shard, scale, rng)
        else:
            decisions, after = _of_student(states, shard, student, rng)
        yield decisions
        moved = np.abs(after.phi - states.phi).max(axis=1, initial=0.0) >= STILL
        open_ = np.flatnonzero(moved & (after.phase <= params.n_joints))
        scale, scales = scale[open_], scales[open_]
        states = slip_batch(after.take(open_), scales, rng)
        if len(states) == 0:
            return


def _of_teacher(
    states: StateBatch, shard: Visit, scale: FloatArray, rng: np.random.Generator
) -> tuple[Decisions, StateBatch]:
    """What is kept of some states, and where the teacher's choices lead, with noise.

    All are labelled; those near a deadlock are always kept.
    """
    decisions = _labelled(states, shard, rng)
    noise = rng.gumbel(size=decisions.cost_to_go.shape)
    rank = np.where(decisions.feasible, decisions.cost_to_go - noise * scale[:, None], np.inf)
    feasible, valid = decisions.feasible.sum(axis=1), _valid(states, shard.params)
    near_deadlock = (feasible <= FEW) & (valid > FEW)
    kept = (near_deadlock | _drawn(shard, len(states), rng)) & (valid > 1)
    chosen = np.where(feasible > 0, rank.argmin(axis=1), -1)
    return decisions.take(np.flatnonzero(kept)), _executed(states, chosen, shard.params)


def _of_student(
    states: StateBatch, shard: Visit, student: SymmetricNetwork, rng: np.random.Generator
) -> tuple[Decisions, StateBatch]:
    """What is kept of some states, and where the student's choices lead.

    Where its choice is infeasible the teacher helps, and the state is kept. Only what is kept is
    labelled, so that the others are cheap.
    """
    params = shard.params
    chosen = preferred(states, student, params)
    prediction = predict_batch(states, chosen, params)
    wrong = ~prediction.executable(params)
    kept = wrong | (_drawn(shard, len(states), rng) & (_valid(states, params) > 1))
    rows = np.flatnonzero(kept)
    decisions = _labelled(states.take(rows), shard, rng, also=chosen[rows])
    best = np.where(decisions.feasible.any(axis=1), decisions.cost_to_go.argmin(axis=1), -1)
    helped = _executed(states.take(np.flatnonzero(wrong)), best[wrong[rows]], params)
    after = successors(states, chosen, prediction, params).put(np.flatnonzero(wrong), helped)
    return decisions.take(np.flatnonzero(decisions.mask.sum(axis=1) > 1)), after


def _executed(states: StateBatch, modes: IntArray, params: SnakeParams) -> StateBatch:
    """Where modes lead, shape (N,); in a deadlock, -1, the state stays as it is."""
    going = np.flatnonzero(modes >= 0)
    after, _ = advance_batch(states.take(going), modes[going], params)
    return states.put(going, after)


def preferred(states: StateBatch, network: SymmetricNetwork, params: SnakeParams) -> IntArray:
    """The modes that a policy's network prefers of those that are stable at t_k, shape (N,)."""
    mask = action_masks(states, params)
    modes: IntArray = np.where(mask, network(observe(states, params)), -np.inf).argmax(axis=1)
    return modes


def _labelled(
    states: StateBatch, shard: Visit, rng: np.random.Generator, also: IntArray | None = None
) -> Decisions:
    """What the teacher says about some states: about all their modes, or many."""
    tried = sampled_modes(states, rng, shard.params, also)
    return label(states, network_value(shard.value, shard.params), shard.params, tried)


def _drawn(shard: Visit, count: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which of some ordinary states are kept."""
    return rng.random(count) * shard.oversampling < 1.0


def _valid(states: StateBatch, params: SnakeParams) -> IntArray:
    """How many modes the phase of each state allows."""
    allowed: IntArray = mode_table(params.n_joints).masks(states.phase).sum(axis=1)
    return allowed
