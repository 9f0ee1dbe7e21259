"""A shield for policies that do not predict: it executes nothing that breaks (22), (23) or touches."""

from __future__ import annotations

import numpy as np

from snake_env.params import SnakeParams
from snake_env.policies.base import CANDIDATES, Policy, models_of
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import predict
from snake_env.state import IntArray, SnakeState


class ShieldedPolicy:
    """The first of a policy's choices that is feasible, then (21), then what holds out longest.

    Of a policy that ranks its choices, the preferred mode is predicted alone, then the next eight;
    from others there is one choice.

    Args:
        policy: Whose choices are checked.
        params: The constants that the checks predict with.
    """

    def __init__(self, policy: Policy, params: SnakeParams) -> None:
        self.models = models_of(policy)
        self._policy, self._params = policy, params
        self._optimizer = AnalyticOptimizer(params)
        self._spent = 0

    @property
    def rollouts(self) -> int:
        """The policy's own model roll-outs and those of the checks."""
        return self._policy.rollouts + self._spent

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode."""
        self._policy.reset(seed)

    def select_mode(self, state: SnakeState) -> int:
        """A feasible mode wherever there is one."""
        for modes in self._in_turn(state):
            mode = self._first_feasible(state, modes)
            if mode is not None:
                return mode
        selection = self._optimizer.select(state)
        self._spent += len(selection.modes)
        return selection.last_resort

    def _in_turn(self, state: SnakeState) -> list[IntArray]:
        """The policy's choices, in the portions in which they are checked."""
        if not isinstance(self._policy, NetworkPolicy):
            return [np.array([self._policy.select_mode(state)])]
        ranked = self._policy.ranking(state)[: 1 + CANDIDATES]
        return [ranked[:1], ranked[1:]]

    def _first_feasible(self, state: SnakeState, candidates: IntArray) -> int | None:
        """The first of some modes that is feasible and lets no links touch; None where none is."""
        prediction = predict(state, candidates, self._params)
        self._spent += len(candidates)
        good = prediction.executable(self._params)
        return int(candidates[good.argmax()]) if good.any() else None
