"""The planner: searches for a whole plan and never gives it up for a worse one."""

from __future__ import annotations

import math
import time

import numpy as np

from snake_env.errors import InvalidInputError, as_finite, as_integer
from snake_env.params import SnakeParams
from snake_env.policies.base import models_of
from snake_env.policies.search import Budget, Plan, search
from snake_env.policies.value import ValueFunction, load_value
from snake_env.sim.episode import has_moved
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.state import SnakeState

RESTARTS = 8
"""Searches with perturbed values where no plan has been found."""
FAILURES = 3
"""After this many complete searches without a plan, (21) continues alone."""
CUT_SHORT = 0.25
"""How much of a failure a search is that the deadline ended."""


class LookaheadPolicy:
    """Plays (21) to the end, then looks for shorter plans in increasingly wide beam searches.

    The model is deterministic, so a plan that is followed comes true: the search happens at the first
    decision, and again only where the robot is not where the plan says. Anytime: when the deadline has
    passed, the best plan so far is followed.

    Args:
        params: The constants that it predicts with.
        width: States that the widest search follows at a time.
        depth: Intervals after which they no longer compete, see
            :func:`snake_env.policies.search.beam_search`; None: they always do.
        deadline_ms: Time for a decision [ms]; ``inf``: none, so that decisions don't depend on the
            machine.
        value: Says how promising a state is; default: the shipped network, or the phases left where
            none ships for as many joints.
        transfer: Whether a shipped network that was trained with other constants may guide the search.

    Raises:
        InvalidInputError: An option can't be used, or the shipped networks are for other constants.
    """

    def __init__(
        self,
        params: SnakeParams,
        width: int = 64,
        depth: int | None = None,
        deadline_ms: float = 1000.0,
        value: ValueFunction | None = None,
        transfer: bool = False,
    ) -> None:
        for name, given in (("width", width), ("depth", depth)):
            number = as_integer(given)
            if (given is not None or name == "width") and (number is None or number < 1):
                raise InvalidInputError(name, given, "a positive integer")
        if deadline_ms != math.inf and ((as_finite(deadline_ms) or 0.0) <= 0.0):
            raise InvalidInputError("deadline_ms", deadline_ms, "a positive number, or inf")
        self.params, self.width, self.depth, self.deadline_ms = params, width, depth, deadline_ms
        self.rollouts = 0
        self._optimizer = AnalyticOptimizer(params)
        self._value = load_value(params, transfer=transfer) if value is None else value
        self.models = models_of(self._value)
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Forgets the plan; ``seed`` decides how values are perturbed where no plan is found."""
        self._seed = 0 if seed is None else seed
        self._plan: Plan | None = None
        self._failures = 0.0
        self._in_vain: SnakeState | None = None

    def select_mode(self, state: SnakeState) -> int:
        """The first mode of the best plan; where there is none, what (21) would do."""
        if not self._plan or not _same(state, self._plan.states[0]):
            self._plan = self._search(state) if self._is_worth_a_search(state) else None
        if not self._plan:
            selection = self._optimizer.select(state)
            self.rollouts += len(selection.modes)
            return selection.last_resort
        mode = self._plan.modes[0]
        self._plan = self._plan.rest()
        return mode

    def _search(self, state: SnakeState) -> Plan | None:
        """The best plan that is found in time."""
        budget = Budget(deadline=time.perf_counter() + self.deadline_ms / 1e3)
        plan = search(
            state,
            self._value,
            self.params,
            width=self.width,
            depth=self.depth,
            restarts=RESTARTS,
            seed=self._seed,
            budget=budget,
        )
        self.rollouts += budget.spent
        if plan is None:
            self._in_vain = state
            self._failures += CUT_SHORT if budget.exhausted else 1.0
        return plan

    def _is_worth_a_search(self, state: SnakeState) -> bool:
        """Whether searches have not failed too often, and not from this very shape."""
        last = self._in_vain
        moved = last is None or has_moved(last.phase, last.phi, state)
        return moved and self._failures < FAILURES


def _same(one: SnakeState, other: SnakeState) -> bool:
    """Whether a plan for one state comes true in the other."""
    return (
        one.phase == other.phase
        and (one.phase_time, one.ref_start) == (other.phase_time, other.ref_start)
        and np.array_equal(one.phi, other.phi)
        and np.array_equal(one.w, other.w)
        and np.array_equal(one.target, other.target)
    )
