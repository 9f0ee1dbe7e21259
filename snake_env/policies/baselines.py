"""Policies that no one has trained: the paper's optimiser (21), and the floors of comparison."""

from __future__ import annotations

import functools
import importlib.resources
import json

import numpy as np
from numpy.typing import NDArray

from snake_env.errors import InvalidInputError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies.base import CANDIDATES
from snake_env.sim.lanes import check_running, check_state
from snake_env.sim.masks import instant_mask
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import predict
from snake_env.state import SnakeState


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
    """The feasible mode of lowest index, predicting modes eight at a time."""

    def __init__(self, params: SnakeParams) -> None:
        self.params = params
        self.rollouts = 0

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode; nothing is remembered."""

    def select_mode(self, state: SnakeState) -> int:
        """The first feasible mode, or the first of all where there is none."""
        modes = mode_table(self.params.n_joints).valid(state.phase)
        for start in range(0, len(modes), CANDIDATES):
            block = modes[start : start + CANDIDATES]
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
        check_state(state, self.params)
        check_running(state)
        mask = instant_mask(state, self.params)
        return int(self._rng.choice(np.flatnonzero(mask)))


@functools.lru_cache(maxsize=1)
def reduced_candidates() -> NDArray[np.bool_]:
    """The candidates of ``analytic-14`` for 8 joints, shape (8, 99)."""
    resource = importlib.resources.files("snake_env") / "policies" / "analytic_14.json"
    modes = json.loads(resource.read_text(encoding="utf-8"))["modes"]
    candidates = np.zeros((8, len(mode_table(8))), dtype=np.bool_)
    for phase, indices in modes.items():
        candidates[int(phase) - 1, indices] = True
    candidates.setflags(write=False)
    return candidates


def analytic_14(params: SnakeParams) -> AnalyticPolicy:
    """(21) over the candidates that it chooses most often, at most 14 a phase."""
    if params.n_joints != 8:
        raise InvalidInputError("n_joints", params.n_joints, "8 for the policy analytic-14")
    return AnalyticPolicy(params, reduced_candidates())
