"""What frames show: the robot inside an interval, or at a switching time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from snake_env.params import SnakeParams
from snake_env.rendering.drawing import lifted_wheels
from snake_env.sim.motion import trajectory
from snake_env.state import FloatArray, SnakeState

FRAMES_PER_SECOND = 20
FRAME_EVERY_S = 0.15  # of the robot's time: videos run three times as fast as the robot


@dataclass(frozen=True, eq=False)
class Scene:
    """What a frame shows.

    Attributes:
        phi: Joint angles, shape (n,) [rad].
        w: Head pose, shape (3,) [m, m, rad].
        target: Target joint angles, shape (n,) [rad].
        lifted: Wheels in the air, shape (n,).
        scp: The phase's joint, 1 to n; n + 1 once the target is reached.
        time: Time since the episode began [s].
        caption: Phase and mode in words.
        alarm: What went wrong, or empty.
    """

    phi: FloatArray
    w: FloatArray
    target: FloatArray
    lifted: NDArray[np.bool_]
    scp: int
    time: float
    caption: str
    alarm: str = ""


def motion_scenes(
    before: SnakeState, mode: int, params: SnakeParams, *, alarm: str = ""
) -> list[Scene]:
    """Scenes of an interval, one every :data:`FRAME_EVERY_S` and one at its end.

    Args:
        before: The robot at t_k.
        mode: The mode, valid in its phase.
        params: The constants.
        alarm: What the last scene warns of.
    """
    motion = trajectory(before, mode, params)
    steps = len(motion.u)
    every = max(1, round(FRAME_EVERY_S / params.dt))
    shown = [*range(every, steps, every), steps]
    lifted = lifted_wheels(mode, before.phase, params)
    caption = f"phase {before.phase}   mode {mode}"
    return [
        Scene(
            phi=motion.phi[k],
            w=motion.w[k],
            target=before.target,
            lifted=lifted,
            scp=before.phase,
            time=before.elapsed + k * params.dt,
            caption=caption,
            alarm=alarm if k == steps else "",
        )
        for k in shown
    ]


def still_scene(state: SnakeState, params: SnakeParams, *, alarm: str = "") -> Scene:
    """The robot at a switching time, with no more wheels in the air than the phase demands."""
    done = state.done
    up = lifted_wheels(0, state.phase, params)  # none once the target is reached
    return Scene(
        phi=state.phi,
        w=state.w,
        target=state.target,
        lifted=up,
        scp=state.phase,
        time=state.elapsed,
        caption="target reached" if done else f"phase {state.phase}",
        alarm=alarm,
    )
