"""Tasks that a policy loses to a choice that a one-step check rejects.

A good policy makes such a choice in one random task of some hundred, so random tasks hardly teach it
more. Those tasks, and what lies around them, do: prioritized level replay (Jiang, Grefenstette and
Rocktaeschel, ICML 2021), with levels that are collected before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agents.teacher import preferred
from snake_env.envs.slip import NO_SLIP, Slip, slip_batch, slips
from snake_env.networks.network import Network
from snake_env.networks.symmetry import CanonicalNetwork
from snake_env.params import SnakeParams
from snake_env.policies.search import expand
from snake_env.sim.episode import STILL
from snake_env.sim.simulation import advance_batch, least_distances
from snake_env.sim.tasks import random_tasks
from snake_env.state import FloatArray, StateBatch


@dataclass(frozen=True, eq=False)
class Trial:
    """Random tasks to play: a shard of a harvest.

    Attributes:
        seed: The harvest's seed.
        part: The shard's number.
        count: Number of tasks.
        network: The policy.
        params: The constants.
        slip: How much the wheels slip; each episode by its own share of it, from 0 to 2.
    """

    seed: int
    part: int
    count: int
    network: Network
    params: SnakeParams
    slip: Slip = NO_SLIP


@dataclass(frozen=True, eq=False)
class Lost:
    """The tasks of a shard that were lost to such a choice.

    Attributes:
        part: The shard's number.
        phi0: Initial shapes, shape (N, n) [rad].
        target: Target shapes, shape (N, n) [rad].
    """

    part: int
    phi0: FloatArray
    target: FloatArray


def play(shard: Trial) -> Lost:
    """Plays a shard's tasks; lost are those in which a wrong mode was chosen where another was right.

    Wrong are modes that are infeasible or let links touch. Robots that stand still are left there.
    """
    params = shard.params
    rng = np.random.default_rng(np.random.SeedSequence(shard.seed, spawn_key=(shard.part, 0)))
    phi0, target = random_tasks(rng.spawn(shard.count), params)
    network = CanonicalNetwork(shard.network, params.n_joints)
    states, task = StateBatch.initial(phi0, target, params), np.arange(shard.count)
    lost = np.zeros(shard.count, dtype=np.bool_)
    scales = slips(shard.slip, shard.count, rng)
    for _ in range(params.horizon):
        after, prediction = advance_batch(states, preferred(states, network, params), params)
        wrong = np.flatnonzero(~prediction.feasible | (prediction.d_min < params.d_touch))
        avoidable = np.unique(expand(states.take(wrong), params).parent)
        lost[task[wrong[avoidable]]] = True
        going = np.abs(after.phi - states.phi).max(axis=1) >= STILL
        going &= after.phase <= params.n_joints
        going[wrong] = False
        task = task[going]
        states = slip_batch(after.take(np.flatnonzero(going)), scales[task], rng)
    return Lost(shard.part, phi0[lost], target[lost])


def around(
    phi0: FloatArray,
    target: FloatArray,
    copies: int,
    spread: float,
    rng: np.random.Generator,
    params: SnakeParams,
) -> tuple[FloatArray, FloatArray]:
    """Tasks, and others close to them; fewer where links would touch.

    Args:
        phi0: Initial shapes, shape (N, n) [rad].
        target: Target shapes, shape (N, n) [rad].
        copies: How many close ones to make of each.
        spread: Standard deviation of each joint's change [rad].
        rng: Source of randomness.
        params: The constants.

    Returns:
        Initial and target shapes, each of shape (M, n) with M at most N (1 + copies) [rad].
    """
    limit = params.phi_limit
    near = [
        np.clip(shapes + spread * rng.normal(size=(copies, *shapes.shape)), -limit, limit)
        for shapes in (phi0, target)
    ]
    begins, ends = (shapes.reshape(-1, params.n_joints) for shapes in near)
    apart = np.minimum(least_distances(begins, params), least_distances(ends, params))
    kept = apart >= params.d_collision
    return np.concatenate([phi0, begins[kept]]), np.concatenate([target, ends[kept]])
