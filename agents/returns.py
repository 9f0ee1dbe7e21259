"""Returns of the value network's own play, to which the next one is fitted (:mod:`agents.value`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agents.failures import failure_cost
from agents.sampling import sampled_modes
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.policies.one_step import MIN_PROGRESS
from snake_env.policies.search import Expansion, best_of_each, expand
from snake_env.policies.value import PhaseValue, ValueFunction, network_value
from snake_env.sim.observation import observe
from snake_env.sim.slip import NO_SLIP, Slip, randomised_slips, slip_batch
from snake_env.sim.tasks import random_tasks
from snake_env.state import FloatArray, IntArray, StateBatch

_LAST = 1e5  # intervals: more than anything is worth
_EXPLORED = 10  # an episode explores for fewer intervals than this
_AT_ONCE = 0.25  # share of episodes that don't explore at all
_NOISE = (0.3, 3.0)  # least and largest scale of the noise [intervals]


@dataclass(frozen=True, eq=False)
class Play:
    """Episodes to play: a shard of a generation.

    Attributes:
        seed: The run's seed.
        generation: Which generation this is.
        part: Which shard of it.
        count: Number of episodes.
        network: The present value; None: minus the potential of the reward.
        trace_decay: Lambda.
        params: The constants.
        slip: How much the wheels slip; each episode by its own share of it, from 0 to 2.
    """

    seed: int
    generation: int
    part: int
    count: int
    network: Network | None
    trace_decay: float
    params: SnakeParams
    slip: Slip = NO_SLIP


@dataclass(frozen=True, eq=False)
class Returns:
    """What states were worth.

    Attributes:
        part: The shard that they come from.
        observations: Shape (N, observation_size).
        intervals: Their lambda-returns, at most :func:`agents.failures.failure_cost`, shape (N,).
        strict: Episodes that did not explore.
        solved: Those of them that reached the target.
        time: Their intervals, all together.
    """

    part: int
    observations: NDArray[np.float32]
    intervals: NDArray[np.float32]
    strict: int
    solved: int
    time: int


def value_of(network: Network | None, params: SnakeParams) -> ValueFunction:
    """The value function of a network; without one, minus the potential of the reward."""
    if network is None:
        return PhaseValue(params)
    return network_value(network, params)


def play(shard: Play) -> Returns:
    """Plays a shard's episodes side by side."""
    params, count = shard.params, shard.count
    key = (shard.generation, shard.part)
    streams = [np.random.SeedSequence(shard.seed, spawn_key=(*key, k)) for k in range(count)]
    rng = np.random.default_rng(np.random.SeedSequence(shard.seed, spawn_key=(*key, count)))
    phi0, target = random_tasks([np.random.default_rng(stream) for stream in streams], params)
    value = value_of(shard.network, params)
    explores = np.where(rng.random(count) < _AT_ONCE, 0, rng.integers(_EXPLORED, size=count))
    explores[0] = 0  # so that every shard has returns
    low, high = np.log(_NOISE)
    scale = np.exp(rng.uniform(low, high, count))
    scales = randomised_slips(shard.slip, count, rng)
    states, task = _wander(
        StateBatch.initial(phi0, target, params), explores, scale, scales, value, rng, params
    )
    needed, observations, intervals = _greedy(
        states, value, shard.trace_decay, scales[task], rng, params
    )
    solved = (explores[task] == 0) & (needed < failure_cost(params))
    return Returns(
        part=shard.part,
        observations=observations,
        intervals=intervals,
        strict=int((explores == 0).sum()),
        solved=int(solved.sum()),
        time=int(needed[solved].sum()),
    )


def _wander(
    states: StateBatch,
    explores: IntArray,
    scale: FloatArray,
    scales: FloatArray,
    value: ValueFunction,
    rng: np.random.Generator,
    params: SnakeParams,
) -> tuple[StateBatch, IntArray]:
    """Where episodes are after their exploration, and which ones: of some it is the end."""
    task = np.arange(len(states))
    for depth in range(_EXPLORED):
        going = explores[task] > depth
        noisy = np.flatnonzero(going)
        now = states.take(noisy)
        tree = expand(now, params, sampled_modes(now, rng, params))
        parent = noisy[tree.parent]
        noise = rng.gumbel(size=len(parent)) * scale[task[parent]]
        rank = value(tree.states) - noise + _creeping(tree, now)
        chosen = best_of_each(parent, rank)
        moved = parent[chosen]
        after = slip_batch(tree.states.take(chosen), scales[task[moved]], rng)
        states = states.put(moved, after)
        kept = ~going
        kept[moved] = after.phase <= params.n_joints
        states, task = states.take(np.flatnonzero(kept)), task[kept]
    return states, task


def _greedy(
    states: StateBatch,
    value: ValueFunction,
    trace_decay: float,
    scales: FloatArray,
    rng: np.random.Generator,
    params: SnakeParams,
) -> tuple[FloatArray, NDArray[np.float32], NDArray[np.float32]]:
    """Plays greedily from some states, side by side.

    Returns:
        Intervals from each to the target, or what a failure is worth; the observations on the ways and
        their lambda-returns.
    """
    longest = failure_cost(params)
    needed = np.full(len(states), longest)
    seen: list[StateBatch] = []
    steps: list[tuple[IntArray, IntArray, FloatArray]] = []
    now, playing = states, np.arange(len(states))
    while len(playing) and len(steps) < longest:
        tree = expand(now, params, sampled_modes(now, rng, params))
        worth = value(tree.states)
        seen.append(now)
        chosen = best_of_each(tree.parent, worth + _creeping(tree, now))
        moved = playing[tree.parent[chosen]]
        now = slip_batch(tree.states.take(chosen), scales[moved], rng)
        steps.append((playing, moved, worth[chosen]))  # who does not move has deadlocked
        reached = now.phase > params.n_joints
        needed[moved[reached]] = len(steps)
        now, playing = now.take(np.flatnonzero(~reached)), moved[~reached]
    after = np.where(needed < longest, 0.0, longest)
    returns = _lambda_returns(steps, after, trace_decay, longest)
    observations = np.concatenate([observe(states, params) for states in seen])
    return needed, observations, np.concatenate(returns).astype(np.float32)


def _creeping(tree: Expansion, before: StateBatch) -> FloatArray:
    """What keeps a mode that leads nowhere behind all others, as the policies that use the value do."""
    turn = np.abs(tree.states.phi - before.phi[tree.parent]).max(axis=1, initial=0.0)
    return np.where(turn < MIN_PROGRESS, _LAST, 0.0)


def _lambda_returns(
    steps: list[tuple[IntArray, IntArray, FloatArray]],
    after: FloatArray,
    trace_decay: float,
    longest: float,
) -> list[FloatArray]:
    """The returns of each step's episodes, from what they are worth at the end, ``after``."""
    returns = []
    for playing, moved, worth in reversed(steps):
        trusted = np.clip(worth, 0.0, longest)
        ahead = (1.0 - trace_decay) * trusted + trace_decay * after[moved]
        after[moved] = np.minimum(1.0 + ahead, longest)
        returns.append(after[playing])
    return returns[::-1]
