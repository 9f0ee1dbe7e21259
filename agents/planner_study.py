"""Which way of looking ahead is best? ``python -m agents.planner_study``.

Compares what ships, the policy ``lookahead`` (beam search, then follow the plan), with what lost:

* *rollout over (21)*: each of the best modes by J is followed by (21) to the end; the plan that ends
  first is kept, and improved upon at every decision;
* *greedy continuations*: the planner with ``depth=1``, in which the states of the first interval no
  longer compete: the rollout algorithm over the value's greedy policy;
* *closed loop*: the planner searches again at every decision, and keeps its plan unless it finds a
  better one;
* *without a network*: beam search ordered by the phases left and this phase's error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import joblib
import numpy as np
import tyro

from snake_env.lookahead import LookaheadPolicy
from snake_env.optimizer import AnalyticOptimizer
from snake_env.params import SnakeParams
from snake_env.policies import AnalyticPolicy, ValuePolicy
from snake_env.policy import Policy
from snake_env.search import Budget, Plan, analytic_plan
from snake_env.simulation import advance
from snake_env.state import SnakeState
from snake_env.tasks import load_tasks
from snake_env.value import PhaseValue


@dataclass(frozen=True)
class Options:
    """Compare ways of looking ahead."""

    tasks: str = "random:100:77"
    """Tasks to plan for."""
    workers: int = -1
    """Processes; -1: one for each core."""


class RolloutPolicy:
    """The rollout algorithm over (21): the best modes by J, each followed by (21) to the end."""

    def __init__(self, params: SnakeParams, candidates: int = 12) -> None:
        self.params, self.candidates = params, candidates
        self.rollouts = 0
        self._optimizer = AnalyticOptimizer(params)
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Forgets the plan."""
        self._plan: Plan | None = None

    def select_mode(self, state: SnakeState) -> int:
        """The first mode of the best plan so far; candidates widen where none reaches the target."""
        selection = self._optimizer.select(state)
        self.rollouts += len(selection.modes)
        order = selection.modes[np.argsort(selection.prediction.j, kind="stable")]
        best = order[: int(selection.prediction.feasible.sum())].tolist()
        for first in range(0, len(best), self.candidates):
            for mode in best[first : first + self.candidates]:
                plan = self._through(state, mode)
                if plan is not None and plan.better_than(self._plan):
                    self._plan = plan
            if self._plan is not None:
                break
        if self._plan is None:
            return selection.last_resort
        mode = self._plan.modes[0]
        self._plan = self._plan.rest()
        return mode

    def _through(self, state: SnakeState, mode: int) -> Plan | None:
        after, prediction = advance(state, mode, self.params)
        budget = Budget()
        rest = analytic_plan(after, self.params, self.params.horizon, budget)
        self.rollouts += 1 + budget.spent
        if rest is None:
            return None
        cost = float(prediction.cost[0]) + rest.cost
        return Plan([mode, *rest.modes], [state, *rest.states], cost)


class ClosedLoopPolicy(LookaheadPolicy):
    """Searches again at every decision and keeps the better of the new plan and the old one's rest."""

    def select_mode(self, state: SnakeState) -> int:
        """The first mode of the better plan."""
        rest, self._plan = self._plan, None
        found = self._search(state)
        self._plan = rest if rest and (found is None or not found.better_than(rest)) else found
        return super().select_mode(state)


def _beams(**options: float) -> Callable[[SnakeParams], Policy]:
    return lambda params: LookaheadPolicy(params, deadline_ms=float("inf"), **options)


POLICIES: dict[str, Callable[[SnakeParams], Policy]] = {
    "(21)": AnalyticPolicy,
    "rollout over (21), 12 candidates": RolloutPolicy,
    "value, greedy": ValuePolicy,
    "lookahead, width 4": _beams(width=4),
    "lookahead, width 16": _beams(width=16),
    "lookahead, width 64": _beams(width=64),
    "width 64, greedy continuations": _beams(width=64, depth=1),
    "width 64, without a network": lambda params: LookaheadPolicy(
        params, width=64, deadline_ms=float("inf"), value=PhaseValue(params)
    ),
    "closed loop, width 16": lambda params: ClosedLoopPolicy(
        params, width=16, deadline_ms=float("inf")
    ),
}


def play(name: str, task: int, state: SnakeState, params: SnakeParams) -> tuple[int, int, int]:
    """Intervals to the target (0: not reached), decisions and roll-outs of a task."""
    policy = POLICIES[name](params)
    policy.reset(task)
    decisions = 0
    while not state.done and decisions < params.horizon:
        state, prediction = advance(state, policy.select_mode(state), params)
        decisions += 1
        if not prediction.feasible[0]:
            break
    return decisions if state.done else 0, decisions, policy.rollouts


def main(options: Options) -> None:
    """Plays all policies and prints a table."""
    params = SnakeParams()
    suite = load_tasks(options.tasks, params)
    base: np.ndarray | None = None
    print(f"{options.tasks}\n{'policy':34} solved  mean time on what (21) solves too  roll-outs")
    for name in POLICIES:
        played = joblib.Parallel(n_jobs=options.workers)(
            joblib.delayed(play)(name, task, suite.initial(task, params), params)
            for task in range(len(suite))
        )
        intervals, decisions, rollouts = np.array(played).T
        base = intervals if base is None else base
        both = (intervals > 0) & (base > 0)
        mean = intervals[both].mean() * params.delta_t
        ratio = intervals[both].mean() / base[both].mean()
        print(
            f"{name:34} {np.sum(intervals > 0):5d}   {mean:6.2f} s, {ratio:.3f} of (21)'s"
            f"{rollouts.sum() / decisions.sum():24.0f} a decision",
            flush=True,
        )


if __name__ == "__main__":
    main(tyro.cli(Options, prog="python -m agents.planner_study", description=__doc__))
