"""A model that Stable-Baselines3 or sb3-contrib has saved, as a policy of the evaluation.

``SavedModel`` loads a PPO with ``MaskedActorCriticPolicy``, ``SavedMaskable`` a ``MaskablePPO``:

    SB3_MODEL=my_ppo.zip python -m evaluate analytic --policy examples.sb3_model:SavedModel
    SB3_MODEL=my_maskable.zip python -m evaluate analytic --policy examples.sb3_model:SavedMaskable
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO

from snake_env import SnakeParams, SnakeState, action_mask, observe
from snake_env.sim.episode import has_moved


class SavedModel:
    """Chooses what PPO's ``predict`` chooses, and no mode twice where the robot has not moved."""

    def __init__(self, params: SnakeParams) -> None:
        torch.set_num_threads(1)
        self.params, self.rollouts = params, 0
        self.model: Any = self.load(os.environ.get("SB3_MODEL", "my_ppo.zip"))
        self.reset()

    def load(self, path: str) -> Any:
        """The saved model."""
        return PPO.load(path, device="cpu")

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode: nothing has been tried."""
        self.tried: set[int] = set()
        self.where: tuple[int, np.ndarray] | None = None

    def select_mode(self, state: SnakeState) -> int:
        """The mode of highest probability among those that are allowed."""
        mask = action_mask(state, self.params)
        if self.where is None or has_moved(*self.where, state):
            self.tried, self.where = set(), (state.phase, state.phi)
        else:
            self.tried.add(state.last_mode)
            left = mask & ~np.isin(np.arange(len(mask)), list(self.tried))
            mask = left if left.any() else mask
        return self.predict(observe(state, self.params), mask)

    def predict(self, observation: np.ndarray, mask: np.ndarray) -> int:
        """The model's choice."""
        seen = {"observation": observation, "action_mask": mask.astype(np.int8)}
        return int(self.model.predict(seen, deterministic=True)[0])


class SavedMaskable(SavedModel):
    """The same for a model of sb3-contrib's ``MaskablePPO``."""

    def load(self, path: str) -> Any:
        """The saved model."""
        from sb3_contrib import MaskablePPO  # only this class needs it

        return MaskablePPO.load(path, device="cpu")

    def predict(self, observation: np.ndarray, mask: np.ndarray) -> int:
        """The model's choice."""
        return int(self.model.predict(observation, action_masks=mask, deterministic=True)[0])
