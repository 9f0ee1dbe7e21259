"""One-step lookahead: modes are simulated for one interval, and a value network ranks their ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from snake_env.kernel.blocks import block_widths
from snake_env.params import SnakeParams
from snake_env.policies.base import CANDIDATES, models_of
from snake_env.policies.ends import ends, get_ends_program
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.policies.value import NetworkValue, ValueFunction, load_value
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import predict, successors
from snake_env.state import IntArray, SnakeState, StateBatch

MIN_PROGRESS = 0.05
"""Modes in which no joint turns as far as this in an interval lead nowhere [rad]: k_t goes to 0 as a
joint comes close to its limit, and a network that prefers one of them would do so again and again."""


@dataclass(frozen=True)
class Choice:
    """A mode to execute, and whether it leads somewhere (:data:`MIN_PROGRESS`)."""

    mode: int
    makes_progress: bool


def best_mode(
    state: SnakeState, modes: IntArray, value: ValueFunction, params: SnakeParams
) -> Choice | None:
    """The mode whose end needs the fewest intervals, of those that are feasible and let no links touch.

    Modes that lead nowhere are left out while there are others. Ties go to the mode that comes first.

    Args:
        state: The robot at t_k.
        modes: Mode indices, shape (M,), valid in the state's phase. Each costs a roll-out.
        value: Ranks the ends.
        params: The constants.

    Returns:
        The choice; None where no mode can be executed.
    """
    if isinstance(value, NetworkValue):
        found = ends(state, modes, params)  # a network needs no more than what is seen there
        executable, turn = found.executable, found.turn
    else:
        prediction = predict(state, modes, params)
        executable = prediction.executable(params)
        turn = np.abs(prediction.phi - state.phi).max(axis=1)
    moving = executable & (turn >= MIN_PROGRESS)
    leads = bool(moving.any())
    kept = np.flatnonzero(moving if leads else executable)
    if len(kept) <= 1:
        return Choice(int(modes[kept[0]]), leads) if len(kept) else None
    if isinstance(value, NetworkValue):
        worth = value.of_observed(found.observations.take(kept, axis=0), found.reached[kept])
    else:
        before = StateBatch.stack([state]).take(np.zeros(len(kept)))
        worth = value(successors(before, modes[kept], prediction.take(kept), params))
    return Choice(int(modes[kept[np.argmin(worth)]]), leads)


def _load_program(value: ValueFunction, params: SnakeParams) -> None:
    """Compiles or loads what :func:`best_mode` will need, before decisions wait for it."""
    if isinstance(value, NetworkValue):
        for lanes in block_widths():
            get_ends_program(params.n_joints, params.head_contact, lanes)


class ValuePolicy:
    """The feasible mode whose end needs the fewest intervals: simulates all modes, as (21) does.

    Args:
        params: The constants that it predicts with.
        value: Default: the shipped network.
        transfer: Whether that network may have been trained with other constants.

    Raises:
        InvalidInputError: The shipped networks were trained with other constants.
    """

    def __init__(
        self, params: SnakeParams, value: ValueFunction | None = None, transfer: bool = False
    ) -> None:
        self.params = params
        self.rollouts = 0
        if value is None:
            value = load_value(params, transfer)
        self.models = models_of(value)
        _load_program(value, params)
        self._value = value
        self._optimizer = AnalyticOptimizer(params)

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode; nothing is remembered."""

    def select_mode(self, state: SnakeState) -> int:
        """The feasible mode of best value; where none is feasible, the one that holds out longest."""
        valid = self._optimizer.modes(state.phase)
        self.rollouts += len(valid)
        choice = best_mode(state, valid, self._value, self.params)
        if choice is not None:
            return choice.mode
        selection = self._optimizer.select(state)
        self.rollouts += len(selection.modes)
        return selection.last_resort


class CriticPolicy:
    """The modes that a learned policy prefers, simulated; a critic decides between their ends.

    Where none of the k preferred modes leads anywhere, the next k are simulated, then all others;
    where no mode can be executed, (21) finds the one that holds out longest.

    Args:
        policy: Ranks the modes, without roll-outs.
        value: The critic.
        params: The constants that it predicts with.
        k: How many of the preferred modes are simulated at a time.
    """

    def __init__(
        self, policy: NetworkPolicy, value: ValueFunction, params: SnakeParams, k: int = CANDIDATES
    ) -> None:
        self.rollouts = 0
        self.models = (*policy.models, *models_of(value))
        _load_program(value, params)
        self._policy, self._value, self._params, self._k = policy, value, params, k
        self._optimizer = AnalyticOptimizer(params)

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode: nothing has been tried."""
        self._policy.reset(seed)

    def select_mode(self, state: SnakeState) -> int:
        """The preferred mode whose end the critic values most."""
        possible = self._optimizer.modes(state.phase)
        if len(possible) == 1:
            return int(possible[0])
        ranked = self._policy.ranking(state, unless=self._k)
        creeping = None
        for first, last in ((0, self._k), (self._k, 2 * self._k), (2 * self._k, len(ranked))):
            candidates = ranked[first:last]
            if len(candidates) == 0:
                break
            self.rollouts += len(candidates)
            choice = best_mode(state, candidates, self._value, self._params)
            if choice is not None and choice.makes_progress:
                return choice.mode
            creeping = creeping or choice
        if creeping is not None:
            return creeping.mode
        selection = self._optimizer.select(state)
        self.rollouts += len(selection.modes)
        return selection.last_resort
