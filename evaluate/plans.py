"""Anytime search for the shortest plan of a task: beams, each twice as wide as the one before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from snake_env.errors import InvalidModeError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies.search import Budget, Plan, analytic_plan, beam_search, expand, noise_of
from snake_env.policies.value import PhaseValue, load_value
from snake_env.sim.simulation import advance
from snake_env.state import SnakeState, StateBatch

FIRST_WIDTH, LAST_WIDTH = 8, 65_536
COLUMNS = (
    "task",
    "intervals",
    "time_s",
    "cost",
    "rollouts",
    "width",
    "impossible",
    "phase",
    "modes",
)
"""Columns of a table of plans: a task without a plan has no intervals, time, cost and modes.

``rollouts`` and ``width`` tell how hard it was tried: model roll-outs, and the widest search.
``impossible`` is 1 where every way was followed to its deadlock: no choice of modes solves the task.
``phase`` is the furthest phase that any of them reaches, where it is impossible.
"""

Row = dict[str, Any]


@dataclass(frozen=True)
class Problem:
    """A task to be solved: a shard of the search.

    Attributes:
        task: Its id in the suite: decides the random numbers.
        state: Where it begins.
        known: Modes of a plan that is known already, or empty.
        rollouts: Model roll-outs to spend.
        params: The constants.
        transfer: Whether the value network may have been trained with other constants.
    """

    task: int
    state: SnakeState
    known: tuple[int, ...]
    rollouts: int
    params: SnakeParams
    transfer: bool = False


def replay(state: SnakeState, modes: tuple[int, ...], params: SnakeParams) -> Plan | None:
    """The plan that these modes are, or None if they do not lead to the target."""
    states, cost = [], 0.0
    for mode in modes:
        states.append(state)
        try:
            state, prediction = advance(state, mode, params)
        except InvalidModeError:
            return None
        cost += float(prediction.cost[0])
        if not prediction.executable(params)[0]:
            return None
    return Plan(modes, states, cost) if state.done else None


def dead_end(state: SnakeState, params: SnakeParams, budget: Budget) -> int | None:
    """The furthest phase that can be reached, if no way leads to the target.

    Every way is followed; states are merged only where they are equal bit for bit, so this is a proof.

    Returns:
        None where a way reaches the target, or where the budget does not suffice.
    """
    beam, furthest = StateBatch.stack([state]), state.phase
    seen: set[bytes] = set()
    allowed = mode_table(params.n_joints).masks(np.arange(1, params.n_joints + 1)).sum(axis=1)
    while len(beam):
        if allowed[beam.phase - 1].sum() > budget.rollouts:
            budget.rollouts = 0  # too little is left to go on
            return None
        tree = expand(beam, params)
        budget.spend(tree.rollouts)
        furthest = max(furthest, int(tree.states.phase.max(initial=0)))
        if furthest > params.n_joints:
            return None
        new = []
        cam = np.minimum(tree.states.phase_time, params.cam_time)  # the curve is constant after it
        for k, key in enumerate(
            np.column_stack([tree.states.phi, tree.states.w, tree.states.ref_start, cam])
        ):
            mark = key.tobytes() + bytes([int(tree.states.phase[k])])
            if mark not in seen:
                seen.add(mark)
                new.append(k)
        beam = tree.states.take(new)
    return furthest


def solve(problem: Problem) -> Row:
    """Searches for the shortest plan: (21), then beams, each twice as wide as the one before.

    Widths double until the budget is spent. Every width is tried with the learned value and, as long as
    there is no plan, with the phases left instead and with perturbed values. Where there is no plan
    yet, a tenth of the budget goes to the attempt to prove that there is none.
    """
    params, state = problem.params, problem.state
    budget = Budget(rollouts=problem.rollouts)
    plan = replay(state, problem.known, params)
    greedy = analytic_plan(state, params, params.horizon, budget)
    if greedy is not None and greedy.better_than(plan):
        plan = greedy
    furthest = None
    if plan is None:
        proof = Budget(rollouts=problem.rollouts // 10)
        furthest = dead_end(state, params, proof)
        budget.spend(proof.spent)
    value = load_value(params, transfer=problem.transfer)
    phases, noise = PhaseValue(params), noise_of(problem.task)
    width = FIRST_WIDTH
    while furthest is None and not budget.exhausted and width <= LAST_WIDTH:
        for rank, random in ((value, None), (phases, None), (value, noise), (phases, noise)):
            found = beam_search(
                *(state, rank, params),
                width=width,
                longest=params.horizon if plan is None else len(plan),
                budget=budget,
                noise=random,
            )
            if found is not None and found.better_than(plan):
                plan = found
            if plan is not None:
                break
        width *= 2
    return {
        "task": problem.task,
        "intervals": "" if plan is None else len(plan),
        "time_s": "" if plan is None else len(plan) * params.delta_t,
        "cost": "" if plan is None else round(plan.cost, 6),
        "rollouts": budget.spent,
        "width": width // 2 if width > FIRST_WIDTH else 0,
        "impossible": int(furthest is not None),
        "phase": "" if furthest is None else furthest,
        "modes": "" if plan is None else " ".join(map(str, plan.modes)),
    }
