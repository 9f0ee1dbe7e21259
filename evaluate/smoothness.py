"""Does the joint input jump? ``python -m evaluate.smoothness [POLICY] [--tasks paper-500]``.

The paper's claim: although modes and phases are switched, the input does not jump. Compared are the
largest change of any joint's input from one sub-step to the next, inside the intervals and across the
switches between them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Annotated

import joblib
import numpy as np
import tyro

from evaluate.protocol import Shard, run_shard
from evaluate.replay import replay
from harness.options import Assignments, parse
from snake_env.params import SnakeParams, parse_overrides
from snake_env.policies.registry import load_policy
from snake_env.sim.tasks import load_tasks
from snake_env.state import SnakeState
from snake_env.system.exit_code import exit_code


@dataclass(frozen=True)
class Options:
    """Compare the input's changes inside the intervals with those at the switches."""

    policy: Annotated[str, tyro.conf.Positional] = "analytic"
    """The policy that chooses the modes."""
    tasks: str = "paper-500"
    """Tasks to run."""
    preset: str = "paper"
    """Constants of the robot."""
    set: Assignments = ()
    """Replaces a constant of the preset; may be repeated."""


@dataclass(frozen=True)
class Changes:
    """Largest changes of the input between sub-steps in an episode [rad/s]: 0 where there is none.

    Attributes:
        inside: Inside the intervals.
        at_mode: Where the mode was switched and the phase was not.
        at_phase: Where the phase shifted.
    """

    inside: float
    at_mode: float
    at_phase: float


def input_changes(policy: str, state: SnakeState, params: SnakeParams, seed: int) -> Changes:
    """Largest changes of the input in one episode."""
    (row,) = run_shard(Shard(policy, [seed], [state], params))
    played = replay(row, state, params)
    inside, at_mode, at_phase = [0.0], [0.0], [0.0]
    for k, motion in enumerate(played.motions):
        if len(motion.u) > 1:
            inside.append(float(np.abs(np.diff(motion.u, axis=0)).max()))
        if k > 0:
            jump = float(np.abs(motion.u[0] - played.motions[k - 1].u[-1]).max())
            shifted = played.states[k].phase != played.states[k - 1].phase
            (at_phase if shifted else at_mode).append(jump)
    return Changes(max(inside), max(at_mode), max(at_phase))


def main() -> int:
    """Runs the command; its exit code."""
    return exit_code(_command)


def _command() -> int:
    options = parse(Options, "python -m evaluate.smoothness")
    params = SnakeParams.preset(options.preset, **parse_overrides(options.set))
    load_policy(options.policy, params)
    suite = load_tasks(options.tasks, params)
    changes = joblib.Parallel(n_jobs=-1)(
        joblib.delayed(input_changes)(options.policy, suite.initial(task, params), params, task)
        for task in range(len(suite))
    )
    print(f"{options.policy} on {suite.name}: largest change of an input per {params.dt} s [rad/s]")
    for name in ("inside", "at_mode", "at_phase"):
        values = np.array([getattr(change, name) for change in changes])
        place = {
            "inside": "inside intervals",
            "at_mode": "mode switched",
            "at_phase": "phase shifted",
        }
        print(
            f"  {place[name]:17} max {values.max():.4f}   median over tasks {np.median(values):.4f}"
        )
    jumps = sum(max(c.at_mode, c.at_phase) > c.inside for c in changes)
    print(f"  tasks where a switch changes an input more than the motion inside intervals: {jumps}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
