"""Replays an episode with its motion inside the intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from snake_env.drawing import lifted_wheels
from snake_env.params import SnakeParams
from snake_env.simulation import Trajectory, advance, trajectories
from snake_env.state import SnakeState, StateBatch


@dataclass(frozen=True, eq=False)
class Replay:
    """An episode, interval by interval.

    Attributes:
        states: The robot at each t_k, and at the end.
        modes: The mode of each interval.
        motions: The motion inside each interval.
    """

    states: list[SnakeState]
    modes: list[int]
    motions: list[Trajectory]

    def lifted(self, interval: int, params: SnakeParams) -> np.ndarray:
        """Which wheels are in the air during an interval, the SCP's included, shape (n,)."""
        return lifted_wheels(self.modes[interval], self.states[interval].phase, params)


def replay(state: SnakeState, modes: list[int], params: SnakeParams) -> Replay:
    """Executes the given modes from a state."""
    states = [state]
    for mode in modes:
        states.append(advance(states[-1], mode, params)[0])
    motions = trajectories(StateBatch.stack(states[:-1]), modes, params) if modes else []
    return Replay(states, modes, motions)
