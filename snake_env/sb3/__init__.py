"""Stable-Baselines3: its vector environment, and policies that know masks."""

from snake_env.errors import MissingDependencyError

try:
    import stable_baselines3  # noqa: F401
except ImportError:
    raise MissingDependencyError(
        "snake_env.sb3 needs Stable-Baselines3: pip install snake-mode-env[train]"
    ) from None

from snake_env.sb3.masked import (
    MaskedActorCriticPolicy,
    MaskedDQN,
    MaskedDQNPolicy,
    ObservationExtractor,
)
from snake_env.sb3.model_writer import write_sb3_model
from snake_env.sb3.vec_env import SnakeVecEnv

__all__ = [
    "MaskedActorCriticPolicy",
    "MaskedDQN",
    "MaskedDQNPolicy",
    "ObservationExtractor",
    "SnakeVecEnv",
    "write_sb3_model",
]
