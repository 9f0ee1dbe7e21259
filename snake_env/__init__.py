"""snake-mode-env: learn which wheels a snake robot lifts.

The physics: :class:`SnakeParams`, :class:`SnakeState`, :class:`ModeTable`, :func:`predict`,
:func:`advance`. The baseline: :class:`AnalyticOptimizer`. The environment:
``gymnasium.make("snake_env:SnakeModeSelection-v0")``. Anything that chooses modes: :func:`load_policy`.
"""

# ruff: noqa: E402  # interrupts are taken before anything else is imported
from snake_env.system import interrupts

interrupts.start()

import gymnasium

from snake_env.errors import (
    InvalidInputError,
    InvalidModeError,
    MissingDependencyError,
    SnakeEnvError,
    UnknownNameError,
)
from snake_env.kernel.blocks import set_num_threads
from snake_env.modes import ModeTable
from snake_env.params import SnakeParams
from snake_env.policies.base import Policy
from snake_env.policies.registry import load_policy
from snake_env.sim.masks import action_mask
from snake_env.sim.motion import Trajectory, trajectories, trajectory
from snake_env.sim.observation import observe
from snake_env.sim.optimizer import AnalyticOptimizer, Selection
from snake_env.sim.simulation import (
    Prediction,
    advance,
    advance_batch,
    cost,
    joint_input,
    predict,
    predict_batch,
)
from snake_env.sim.tasks import TaskSuite, load_tasks
from snake_env.state import SnakeState, StateBatch

__version__ = "0.1.0"
VERSION = f"snake-mode-env {__version__}"
"""What ``--version`` prints."""

__all__ = [
    "AnalyticOptimizer",
    "InvalidInputError",
    "InvalidModeError",
    "MissingDependencyError",
    "ModeTable",
    "Policy",
    "Prediction",
    "Selection",
    "SnakeEnvError",
    "SnakeParams",
    "SnakeState",
    "StateBatch",
    "TaskSuite",
    "Trajectory",
    "UnknownNameError",
    "action_mask",
    "advance",
    "advance_batch",
    "cost",
    "joint_input",
    "load_policy",
    "load_tasks",
    "observe",
    "predict",
    "predict_batch",
    "set_num_threads",
    "trajectories",
    "trajectory",
]

for _id, _preset in (
    ("SnakeModeSelection-v0", "paper"),
    ("SnakeModeSelectionNarrow-v0", "narrow"),
    ("SnakeModeSelectionHardware-v0", "hardware"),
    ("SnakeModeSelectionSix-v0", "six"),
    ("SnakeModeSelectionTen-v0", "ten"),
):
    gymnasium.register(
        id=_id,
        entry_point="snake_env.envs:SnakeModeSelectionEnv",
        vector_entry_point="snake_env.envs:SnakeModeSelectionVectorEnv",
        kwargs={"preset": _preset},
    )
