"""The Gymnasium environments, their wrappers and their reward."""

from snake_env.envs.env import SnakeModeSelectionEnv
from snake_env.envs.env_state import EnvState
from snake_env.envs.reward import RewardWeights
from snake_env.envs.vector_env import SnakeModeSelectionVectorEnv
from snake_env.envs.wrappers import ActionMaskObservation, RecordMotion

__all__ = [
    "ActionMaskObservation",
    "EnvState",
    "RecordMotion",
    "RewardWeights",
    "SnakeModeSelectionEnv",
    "SnakeModeSelectionVectorEnv",
]
