"""Search for plans: sequences of modes that lead to the target, on the exact model."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies.value import ValueFunction
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import predict_batch, successors
from snake_env.state import FloatArray, IntArray, SnakeState, StateBatch

SAME_SHAPE = 1e-3
"""Of states of a phase whose joints differ by no more one is kept, whatever else differs [rad]."""
WIDENING = 4
"""Ratio of the widths of successive searches."""
_STREAM = (0, 2)  # spawn key of the random numbers of searches: no task's are among them


@dataclass(frozen=True, eq=False)
class Plan:
    """A way to the target.

    Attributes:
        modes: One mode for each interval.
        states: Where each of them begins, as many as modes.
        cost: Integral of V over the plan, from where it was made [s].
    """

    modes: Sequence[int]
    states: Sequence[SnakeState]
    cost: float

    def __len__(self) -> int:
        return len(self.modes)

    def better_than(self, other: Plan | None) -> bool:
        """Whether it is shorter, or as short at less cost."""
        return other is None or (len(self), self.cost) < (len(other), other.cost)

    def rest(self) -> Plan:
        """What is left of it after its first interval."""
        return Plan(self.modes[1:], self.states[1:], self.cost)


@dataclass(frozen=True, eq=False)
class Expansion:
    """All that can happen to some states in one interval.

    Attributes:
        parent: Which of the states, in rising order, shape (M,).
        mode: Its modes that can be executed, in rising order, shape (M,).
        states: Where they lead.
        cost: Integrals of V, shape (M,) [s].
        rollouts: Modes that were predicted, feasible or not.
    """

    parent: IntArray
    mode: IntArray
    states: StateBatch
    cost: FloatArray
    rollouts: int

    def take(self, indices: IntArray) -> Expansion:
        """Some of what can happen."""
        return Expansion(
            self.parent[indices],
            self.mode[indices],
            self.states.take(indices),
            self.cost[indices],
            self.rollouts,
        )


def expand(
    states: StateBatch, params: SnakeParams, modes: NDArray[np.bool_] | None = None
) -> Expansion:
    """Predicts modes of every state; keeps the feasible ones that let no links touch.

    Args:
        states: N states.
        params: The constants.
        modes: Which valid modes to predict, shape (N, n_modes); None: all.
    """
    if modes is None:
        modes = mode_table(params.n_joints).masks(states.phase)
    parent, mode = np.nonzero(modes)
    begun = states.take(parent)
    prediction = predict_batch(begun, mode, params)
    ended = successors(begun, mode, prediction, params)
    tree = Expansion(parent, mode, ended, prediction.cost, rollouts=len(mode))
    kept = prediction.executable(params)
    return tree if kept.all() else tree.take(np.flatnonzero(kept))


@dataclass
class Budget:
    """What a search may spend, and what it has spent.

    Attributes:
        rollouts: Model roll-outs left.
        deadline: When to stop, on the clock of ``time.perf_counter`` [s].
        spent: Model roll-outs spent.
    """

    rollouts: float = float("inf")
    deadline: float = float("inf")
    spent: int = 0

    def spend(self, rollouts: int) -> None:
        """Records roll-outs."""
        self.rollouts -= rollouts
        self.spent += rollouts

    @property
    def exhausted(self) -> bool:
        """Whether nothing is left."""
        return self.rollouts <= 0 or time.perf_counter() >= self.deadline


def search(
    start: SnakeState,
    value: ValueFunction,
    params: SnakeParams,
    *,
    width: int,
    budget: Budget,
    depth: int | None = None,
    restarts: int = 0,
    seed: int = 0,
) -> Plan | None:
    """The best plan of (21) and of increasingly wide beam searches.

    Anytime; without a limit it is never worse than (21).

    Args:
        start: Where the plan begins; not the target.
        value: Says how promising a state is.
        params: The constants.
        width: States that the widest search follows at a time.
        budget: What may be spent; the best plan found until then counts.
        depth: See :func:`beam_search`.
        restarts: Searches with perturbed values where no plan has been found.
        seed: Decides how they are perturbed.

    Returns:
        The shortest plan found, of those the one of least cost; None where there is none.
    """
    left = max(1, params.horizon - round(start.elapsed / params.delta_t))
    plan = analytic_plan(start, params, left, budget)
    widths = [width]
    while widths[0] > WIDENING:
        widths.insert(0, widths[0] // WIDENING)
    for each in widths:
        longest = left if plan is None else len(plan)
        found = beam_search(
            start, value, params, width=each, longest=longest, budget=budget, depth=depth
        )
        if found is not None and found.better_than(plan):
            plan = found
    noise = noise_of(seed)
    for _ in range(restarts):
        if plan is not None or budget.exhausted:
            break
        plan = beam_search(
            start, value, params, width=width, longest=left, budget=budget, depth=depth, noise=noise
        )
    return plan


def noise_of(seed: int) -> np.random.Generator:
    """The source of the noise in searches that a task's id seeds."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=_STREAM))


def analytic_plan(
    state: SnakeState, params: SnakeParams, longest: int, budget: Budget
) -> Plan | None:
    """Plays (21) to the end; None where it deadlocks, lets links touch or takes too long."""
    optimizer = AnalyticOptimizer(params)
    states: list[SnakeState] = []
    modes: list[int] = []
    cost = 0.0
    while not state.done:
        if len(modes) >= longest or budget.exhausted:
            return None
        selection = optimizer.select(state)
        budget.spend(len(selection.modes))
        if selection.mode is None:
            return None
        states.append(state)
        modes.append(selection.mode)
        chosen = selection.prediction.take(np.flatnonzero(selection.modes == selection.mode))
        if not chosen.executable(params)[0]:
            return None
        state = successors(StateBatch.stack([state]), [selection.mode], chosen, params)[0]
        cost += float(chosen.cost[0])
    return Plan(modes, states, cost)


def beam_search(
    start: SnakeState,
    value: ValueFunction,
    params: SnakeParams,
    *,
    width: int,
    longest: int,
    budget: Budget,
    depth: int | None = None,
    noise: np.random.Generator | None = None,
) -> Plan | None:
    """Looks for the shortest plan, following the most promising states from interval to interval.

    Args:
        start: Where the plan begins; not the target.
        value: Says how promising a state is.
        params: The constants.
        width: States that are followed at a time.
        longest: Longest plan that is of use [intervals].
        budget: What may be spent; a search that exhausts it gives None.
        depth: Intervals after which the states no longer compete: each is then followed greedily to
            its own end, as in the *rollout* algorithm. None: they always compete.
        noise: Perturbs the values, so that repeated searches find different plans.

    Returns:
        Of the shortest plans found the one of least cost; None where there is none.
    """
    beam, cost = StateBatch.stack([start]), np.zeros(1)
    levels: list[tuple[StateBatch, IntArray, IntArray]] = []  # states, each one's modes and parents
    for step in range(1, longest + 1):
        if budget.exhausted:
            return None
        tree = expand(beam, params)
        budget.spend(tree.rollouts)
        if len(tree.mode) == 0:
            return None
        total = cost[tree.parent] + tree.cost
        reached = np.flatnonzero(tree.states.phase > params.n_joints)
        if len(reached):
            last = int(reached[np.argmin(total[reached])])
            levels.append((beam, tree.mode, tree.parent))
            return _plan_to(last, float(total[last]), levels)
        rank = value(tree.states)
        if noise is not None:
            rank = rank + noise.gumbel(size=len(rank))
        if depth is None or step <= depth:
            kept = _best(tree.states, rank, width)
        else:
            kept = best_of_each(tree.parent, rank)
        levels.append((beam, tree.mode[kept], tree.parent[kept]))
        beam, cost = tree.states.take(kept), total[kept]
    return None


def _plan_to(last: int, cost: float, levels: list[tuple[StateBatch, IntArray, IntArray]]) -> Plan:
    """The plan that ends with the mode at position ``last`` of the last level."""
    modes: list[int] = []
    states: list[SnakeState] = []
    for beam, mode, parent in reversed(levels):
        modes.append(int(mode[last]))
        last = int(parent[last])
        states.append(beam[last])
    return Plan(modes[::-1], states[::-1], cost)


def _best(states: StateBatch, rank: FloatArray, width: int) -> IntArray:
    """Positions of the ``width`` states of lowest rank that differ from each other."""
    order = np.argsort(rank, kind="stable")[: 4 * width]
    shapes = np.round(states.phi[order] / SAME_SHAPE)
    _, first = np.unique(np.column_stack([states.phase[order], shapes]), axis=0, return_index=True)
    return order[np.sort(first)[:width]]


def best_of_each(parent: IntArray, rank: FloatArray) -> IntArray:
    """Position of each parent's successor of lowest rank; ties go to the first.

    Args:
        parent: Parents of M successors, in any order, shape (M,).
        rank: The successors' ranks, shape (M,).

    Returns:
        One position for each parent that has a successor, by rising parent.
    """
    order = np.lexsort((rank, parent))
    _, first = np.unique(parent[order], return_index=True)
    return order[first]
