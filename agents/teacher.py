"""Teachers: what every feasible mode of a state would cost, and states worth asking about."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from agents.labels import Decisions, join, mirror_image
from snake_env.modes import mode_table
from snake_env.networks.network import Network
from snake_env.networks.symmetry import SymmetricNetwork
from snake_env.params import SnakeParams
from snake_env.policies.search import best_of_each, expand
from snake_env.policies.value import ValueFunction, load_value, network_value
from snake_env.sim.episode import STILL
from snake_env.sim.masks import action_masks
from snake_env.sim.observation import observe
from snake_env.sim.simulation import advance_batch, least_distances, predict_batch
from snake_env.sim.tasks import random_tasks
from snake_env.state import FloatArray, IntArray, StateBatch

Teacher = Literal["lookahead", "analytic"]
FAILURE = 30.0
"""What a mode costs from whose end the target is not reached, beside the mode itself [intervals]."""
NEAR_LIMIT = 0.05
"""How close to its limit a joint begins in some episodes, at most [rad]."""
FEW = 3
"""A state with at most so many feasible modes is near a deadlock."""
_SIDE_BY_SIDE = 64  # episodes
_LONGEST = 40  # an episode is left after so many decisions
_NOISE = 2.0  # largest scale of the noise in the teacher's choices [intervals]


def judge(
    states: StateBatch,
    teacher: Teacher,
    params: SnakeParams,
    depth: int = 0,
    value: ValueFunction | None = None,
) -> Decisions:
    """What a teacher says about every mode of some states.

    Args:
        states: N states that have not reached their target.
        teacher: ``lookahead`` searches ``depth`` intervals beyond each mode's end and takes the value
            of the best leaf there; ``analytic`` plays (21) from there to the end.
        params: The constants.
        depth: Intervals that ``lookahead`` searches; each costs as many roll-outs as (21) for every
            state that it begins with.
        value: What ``lookahead`` takes values from; default: what ships for these robots.
    """
    tree = expand(states, params)
    if teacher == "analytic":
        after = _analytic_to_go(tree.states, params)
    else:
        after = _to_go(tree.states, value or load_value(params), params, depth)
    shape = (len(states), len(mode_table(params.n_joints)))
    cost = np.full(shape, np.inf, dtype=np.float32)
    cost[tree.parent, tree.mode] = 1.0 + np.minimum(after, FAILURE)
    return Decisions(states, action_masks(states, "instant", params), np.isfinite(cost), cost)


def _to_go(states: StateBatch, value: ValueFunction, params: SnakeParams, depth: int) -> FloatArray:
    """The value of each state's best descendant ``depth`` intervals on, and the way there."""
    result = np.maximum(value(states), 0.0)
    open_ = np.flatnonzero(states.phase <= params.n_joints)
    if depth == 0 or len(open_) == 0:
        return result
    tree = expand(states.take(open_), params)
    beyond = 1.0 + _to_go(tree.states, value, params, depth - 1)
    best = np.full(len(open_), FAILURE)
    np.minimum.at(best, tree.parent, beyond)
    result[open_] = best
    return result


def _analytic_to_go(states: StateBatch, params: SnakeParams) -> FloatArray:
    """Intervals that (21) needs from each state to the end; :data:`FAILURE` where it deadlocks."""
    result = np.full(len(states), FAILURE)
    now, of = states, np.arange(len(states))
    for depth in range(int(FAILURE)):
        reached = now.phase > params.n_joints
        result[of[reached]] = depth
        now, of = now.take(np.flatnonzero(~reached)), of[~reached]
        if len(of) == 0:
            break
        parent, mode = np.nonzero(mode_table(params.n_joints).masks(now.phase))
        j = predict_batch(now.take(parent), mode, params).j
        best = best_of_each(parent, j)
        best = best[np.isfinite(j[best])]  # the others deadlock
        now, _ = advance_batch(now.take(parent[best]), mode[best], params)
        of = of[parent[best]]
    return result


@dataclass(frozen=True, eq=False)
class Visit:
    """A shard of decisions to collect.

    Attributes:
        seed: The collection's seed.
        part: The shard's number.
        decisions: How many, before mirrored copies are added.
        teacher: Who judges the modes.
        depth: See :func:`judge`.
        value: The network that ``lookahead`` takes values from; None: what ships for these robots.
        student: Whose states are visited: a network that prefers modes; None: the teacher's own, with
            noise in its choices.
        overweight: How many times as often as others those states are kept in which the student's
            choice is infeasible or, without a student, those near a deadlock.
        mirrored: Whether the mirror image of each decision is added.
        near_limits: Share of the episodes in which a joint begins close to its limit.
        params: The constants.
    """

    seed: int
    part: int
    decisions: int
    teacher: Teacher
    depth: int
    value: Network | None
    student: Network | None
    overweight: float
    mirrored: bool
    near_limits: float
    params: SnakeParams


def collect(shard: Visit) -> tuple[int, Decisions]:
    """The shard's number, and its decisions: episodes are played until there are enough.

    States in which the phase allows a single mode are no decisions.
    """
    params = shard.params
    kept: list[Decisions] = []
    wave, missing = 0, shard.decisions
    while missing > 0:
        stream = np.random.SeedSequence(shard.seed, spawn_key=(shard.part, wave, 0))
        most = _SIDE_BY_SIDE if shard.student is None else int(_SIDE_BY_SIDE * shard.overweight)
        count = min(most, max(1, missing // 10))  # so that few are cut short
        for decisions in _episodes(shard, count, np.random.default_rng(stream)):
            kept.append(decisions.take(np.arange(min(missing, len(decisions)))))
            missing -= len(kept[-1])
            if missing == 0:
                break
        wave += 1
    decisions = join(kept)
    if shard.mirrored:
        decisions = join([decisions, mirror_image(decisions, params)])
    return shard.part, decisions


def _episodes(shard: Visit, count: int, rng: np.random.Generator) -> Iterator[Decisions]:
    """The decisions of some episodes that are played side by side, interval by interval.

    Robots that come to stand still have nothing more to teach.
    """
    params = shard.params
    phi0, target = random_tasks(rng.spawn(count), params)
    if shard.near_limits > 0.0:
        phi0 = _near_limits(phi0, shard.near_limits, params, rng)
    states = StateBatch.initial(phi0, target, params)
    # Half of the episodes follow the teacher strictly, the others less and less.
    scale = np.maximum(rng.uniform(-1.0, 1.0, count), 0.0) * _NOISE
    student = None if shard.student is None else SymmetricNetwork(shard.student, params.n_joints)
    for _ in range(_LONGEST):
        if student is None:
            decisions, chosen = _of_teacher(states, shard, scale, rng)
        else:
            decisions, chosen = _of_student(states, shard, student, rng)
        yield decisions
        going = np.flatnonzero(chosen >= 0)
        before = states.take(going)
        states, _ = advance_batch(before, chosen[going], params)
        moved = np.abs(states.phi - before.phi).max(axis=1, initial=0.0) >= STILL
        open_ = np.flatnonzero(moved & (states.phase <= params.n_joints))
        states, scale = states.take(open_), scale[going][open_]
        if len(states) == 0:
            return


def _near_limits(
    phi0: FloatArray, share: float, params: SnakeParams, rng: np.random.Generator
) -> FloatArray:
    """Initial shapes of which a share has a joint close to its limit, where links allow that."""
    count, n = phi0.shape
    chosen = np.flatnonzero(rng.random(count) < share)
    joints = rng.integers(n, size=len(chosen))
    margins = rng.uniform(0.0, NEAR_LIMIT, len(chosen))
    moved = phi0.copy()
    moved[chosen, joints] = np.copysign(params.phi_limit - margins, phi0[chosen, joints])
    apart = least_distances(moved, params) >= params.d_collision
    result: FloatArray = np.where(apart[:, None], moved, phi0)
    return result


def _of_teacher(
    states: StateBatch, shard: Visit, scale: FloatArray, rng: np.random.Generator
) -> tuple[Decisions, IntArray]:
    """What is kept of some states, and the teacher's choices, with noise; -1 in a deadlock.

    All are judged; those near a deadlock are always kept.
    """
    decisions = _judged(states, shard)
    noise = rng.gumbel(size=decisions.cost_to_go.shape)
    rank = np.where(decisions.feasible, decisions.cost_to_go - noise * scale[:, None], np.inf)
    feasible, valid = decisions.feasible.sum(axis=1), _valid(states, shard.params)
    near_deadlock = (feasible <= FEW) & (valid > FEW)
    kept = (near_deadlock | _drawn(shard, len(states), rng)) & (valid > 1)
    return decisions.take(np.flatnonzero(kept)), np.where(feasible > 0, rank.argmin(axis=1), -1)


def _of_student(
    states: StateBatch, shard: Visit, student: SymmetricNetwork, rng: np.random.Generator
) -> tuple[Decisions, IntArray]:
    """What is kept of some states, and the student's choices; -1 in a deadlock.

    Where its choice is infeasible the teacher helps, and the state is kept. Only what is kept is
    judged, so that the others are cheap.
    """
    params = shard.params
    chosen = preferred(states, student, params)
    prediction = predict_batch(states, chosen, params)
    wrong = ~(prediction.feasible & (prediction.d_min >= params.d_touch))
    kept = wrong | (_drawn(shard, len(states), rng) & (_valid(states, params) > 1))
    rows = np.flatnonzero(kept)
    decisions = _judged(states.take(rows), shard)
    best = np.where(decisions.feasible.any(axis=1), decisions.cost_to_go.argmin(axis=1), -1)
    chosen[wrong] = best[wrong[rows]]
    return decisions.take(np.flatnonzero(decisions.mask.sum(axis=1) > 1)), chosen


def preferred(states: StateBatch, network: SymmetricNetwork, params: SnakeParams) -> IntArray:
    """The modes that a policy's network prefers of those that are stable at t_k, shape (N,)."""
    mask = action_masks(states, "instant", params)
    modes: IntArray = np.where(mask, network(observe(states, params)), -np.inf).argmax(axis=1)
    return modes


def _judged(states: StateBatch, shard: Visit) -> Decisions:
    """What the shard's teacher says about some states."""
    value = None if shard.value is None else network_value(shard.value, shard.params)
    return judge(states, shard.teacher, shard.params, shard.depth, value)


def _drawn(shard: Visit, count: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which of some ordinary states are kept."""
    return rng.random(count) * shard.overweight < 1.0


def _valid(states: StateBatch, params: SnakeParams) -> IntArray:
    """How many modes the phase of each state allows."""
    allowed: IntArray = mode_table(params.n_joints).masks(states.phase).sum(axis=1)
    return allowed
