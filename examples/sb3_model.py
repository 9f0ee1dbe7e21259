"""A model that Stable-Baselines3 has saved, as a policy of the evaluation.

Evaluate one that was trained with a mask in its observation, as examples/sb3_ppo.py trains it:

    SB3_MODEL=my_ppo.zip python -m evaluate analytic --policy examples.sb3_model:SavedModel
"""

from __future__ import annotations

import os

import numpy as np
from stable_baselines3 import PPO

from snake_env import SnakeParams, SnakeState, action_mask, observe


class SavedModel:
    """Chooses what PPO's ``predict`` chooses."""

    def __init__(self, params: SnakeParams) -> None:
        self.params, self.rollouts = params, 0
        self.model = PPO.load(os.environ.get("SB3_MODEL", "my_ppo.zip"), device="cpu")

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode; nothing is remembered."""

    def select_mode(self, state: SnakeState) -> int:
        """The mode of highest preference."""
        seen = {
            "observation": observe(state, self.params),
            "action_mask": action_mask(state, self.params).astype(np.int8),
        }
        mode, _ = self.model.predict(seen, deterministic=True)
        return int(mode)
