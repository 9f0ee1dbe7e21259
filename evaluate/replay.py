"""Replays an episode with its motion inside the intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evaluate.protocol import Row
from snake_env.params import SnakeParams
from snake_env.rendering.drawing import lifted_wheels
from snake_env.sim.motion import Trajectory, trajectories
from snake_env.sim.slip import Slip, SlipProcess
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


def replay(row: Row, state: SnakeState, params: SnakeParams) -> Replay:
    """Replays the episode of a row.

    Args:
        row: The episode.
        state: Where it begins.
        params: The constants.
    """
    modes, process = modes_of(row), slip_process_of(row, params)
    states = [state]
    for mode in modes:
        states.append(process.advance(states[-1], mode)[0])
    motions = trajectories(StateBatch.stack(states[:-1]), modes, params) if modes else []
    return Replay(states, modes, motions)


def modes_of(row: Row) -> list[int]:
    """The modes that the policy chose."""
    return [int(mode) for mode in row["modes"].split()]


def slip_of(row: Row) -> Slip:
    """How much the wheels slipped."""
    return row["slip_m"], row["slip_rad"]


def slip_process_of(row: Row, params: SnakeParams) -> SlipProcess:
    """The slip of an episode, as it was at the beginning."""
    return SlipProcess(slip_of(row), row["task"], params)
