"""Policies: whatever chooses a mode at each t_k, behind one interface and one registry."""

from __future__ import annotations

import functools
import importlib.resources
import json
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from snake_env.blocks import LANES
from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.masks import action_masks
from snake_env.modes import mode_table
from snake_env.optimizer import AnalyticOptimizer
from snake_env.params import SnakeParams
from snake_env.simulation import predict
from snake_env.state import SnakeState, StateBatch


class Policy(Protocol):
    """Chooses modes.

    Attributes:
        rollouts: Model roll-outs spent so far (one mode predicted over one interval each): the cost
            of the decisions, independent of the machine.
    """

    rollouts: int

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode. A policy that draws random numbers draws them from ``seed``."""

    def select_mode(self, state: SnakeState) -> int:
        """Index of the mode for the next interval: always one that the phase allows."""


class AnalyticPolicy:
    """The paper's optimiser (21); where no candidate is feasible, the one that holds out longest."""

    def __init__(self, params: SnakeParams, candidates: NDArray[np.bool_] | None = None) -> None:
        self.optimizer = AnalyticOptimizer(params, candidates)
        self.rollouts = 0

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode; nothing is remembered."""

    def select_mode(self, state: SnakeState) -> int:
        """The feasible mode of least J."""
        selection = self.optimizer.select(state)
        self.rollouts += len(selection.modes)
        return selection.last_resort


class FirstFeasiblePolicy:
    """The feasible mode of lowest index, predicting no more blocks of modes than it must."""

    def __init__(self, params: SnakeParams) -> None:
        self.params = params
        self.rollouts = 0

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode; nothing is remembered."""

    def select_mode(self, state: SnakeState) -> int:
        """The first feasible mode, or the first of all where there is none."""
        modes = mode_table(self.params.n_joints).valid(state.phase)
        for start in range(0, len(modes), LANES):
            block = modes[start : start + LANES]
            feasible = predict(state, block, self.params).feasible
            self.rollouts += len(block)
            if feasible.any():
                return int(block[np.argmax(feasible)])
        return int(modes[0])


_POLICY_STREAMS = (0, 1)
"""Spawn key of policies' random numbers: no task's numbers are among them."""


class RandomPolicy:
    """A mode drawn uniformly from those that are stable at t_k: the floor of all learning."""

    def __init__(self, params: SnakeParams) -> None:
        self.params = params
        self.rollouts = 0
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode with random numbers of its own."""
        stream = np.random.SeedSequence(0 if seed is None else seed, spawn_key=_POLICY_STREAMS)
        self._rng = np.random.default_rng(stream)

    def select_mode(self, state: SnakeState) -> int:
        """A random mode of the instant mask."""
        mask = action_masks(StateBatch.stack([state]), "instant", self.params)[0]
        return int(self._rng.choice(np.flatnonzero(mask)))


@functools.lru_cache(maxsize=1)
def _reduced_candidates() -> NDArray[np.bool_]:
    """The candidates of ``analytic-14`` for 8 joints, shape (8, 99)."""
    resource = importlib.resources.files("snake_env") / "data" / "analytic_14.json"
    modes = json.loads(resource.read_text(encoding="utf-8"))["modes"]
    candidates = np.zeros((8, len(mode_table(8))), dtype=np.bool_)
    for phase, indices in modes.items():
        candidates[int(phase) - 1, indices] = True
    return candidates


def _analytic_14(params: SnakeParams) -> AnalyticPolicy:
    if params.n_joints != 8:
        raise InvalidInputError("n_joints", params.n_joints, "8 for the policy analytic-14")
    return AnalyticPolicy(params, _reduced_candidates())


POLICIES: dict[str, Callable[[SnakeParams], Policy]] = {
    "analytic": AnalyticPolicy,
    "analytic-14": _analytic_14,
    "first-feasible": FirstFeasiblePolicy,
    "random": RandomPolicy,
}
"""Every policy by name; each entry makes one for given constants."""


def load_policy(name: str, params: SnakeParams | None = None) -> Policy:
    """A policy by name.

    Args:
        name: ``analytic`` (21), ``analytic-14`` (21 over at most 14 candidates a phase, as the paper's
            Table II), ``first-feasible`` or ``random``.
        params: The constants that it predicts with; default: the preset ``paper``.

    Raises:
        UnknownNameError: No such policy.
        InvalidInputError: The policy does not exist for these constants.
    """
    if name not in POLICIES:
        raise UnknownNameError("policy", name, POLICIES)
    return POLICIES[name](params or SnakeParams())
