"""Wrappers: the mask where a library looks for it, and videos of the motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, SupportsFloat, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import RecordVideo
from numpy.typing import DTypeLike, NDArray

from snake_env.errors import InvalidInputError, UnknownNameError


@dataclass(frozen=True)
class MaskFormat:
    """How a library wants observation and mask.

    Attributes:
        observation: Key of the observation.
        mask: Key of the mask.
        dtype: Type of the mask's entries.
        summary: Whether infos may hold the episode's summary, which only the last of each does.
    """

    observation: str
    mask: str
    dtype: DTypeLike
    summary: bool = True


MASK_FORMATS = {
    "sb3": MaskFormat("observation", "action_mask", np.int8),
    "pettingzoo": MaskFormat("observation", "action_mask", np.int8),
    "rllib": MaskFormat("observations", "action_mask", np.float32),
    "tianshou": MaskFormat("obs", "mask", np.bool_, summary=False),  # its buffer refuses such
    "torchrl": MaskFormat("observation", "action_mask", np.bool_),
}
"""The libraries' formats, by name."""


class ActionMaskObservation(
    gymnasium.ObservationWrapper[dict[str, NDArray[Any]], np.int64, NDArray[np.float32]],
    gymnasium.utils.RecordConstructorArgs,
):
    """Makes observations dicts of observation and mask.

    For Tianshou, whose replay buffer keeps infos, it leaves out ``info["episode_summary"]``.

    Args:
        env: The env.
        library: ``sb3``, ``pettingzoo``, ``rllib``, ``tianshou`` or ``torchrl``.

    Raises:
        UnknownNameError: No such library.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], library: str = "sb3") -> None:
        if library not in MASK_FORMATS:
            raise UnknownNameError("library", library, MASK_FORMATS)
        gymnasium.utils.RecordConstructorArgs.__init__(self, library=library)
        super().__init__(env)
        self.format = MASK_FORMATS[library]
        if not isinstance(env.action_space, spaces.Discrete) or not env.has_wrapper_attr(
            "action_masks"
        ):
            raise InvalidInputError(
                "env", type(env.unwrapped).__name__, "an env with action_masks()"
            )
        dtype: Any = self.format.dtype
        mask = spaces.Box(0, 1, (int(env.action_space.n),), dtype)
        both = {self.format.observation: env.observation_space, self.format.mask: mask}
        self.observation_space = cast(Any, spaces.Dict(both))

    def step(
        self, action: np.int64
    ) -> tuple[dict[str, NDArray[Any]], SupportsFloat, bool, bool, dict[str, Any]]:
        """Executes a mode."""
        observation, reward, terminated, truncated, info = super().step(action)
        if not self.format.summary:
            info.pop("episode_summary", None)
        return observation, reward, terminated, truncated, info

    def observation(self, observation: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        """The observation with the mask of now."""
        mask = self.env.get_wrapper_attr("action_masks")()
        return {
            self.format.observation: observation,
            self.format.mask: mask.astype(self.format.dtype),
        }


class RecordMotion(RecordVideo):
    """``RecordVideo`` that keeps every frame of the motion inside an interval, not only its last.

    The env must have the render mode ``rgb_array_list``. All else is as with ``RecordVideo``.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], *args: Any, **kwargs: Any) -> None:
        if env.render_mode != "rgb_array_list":
            raise InvalidInputError("render_mode", env.render_mode, "'rgb_array_list'")
        super().__init__(env, *args, **kwargs)

    def _capture_frame(self) -> None:
        self.recorded_frames.extend(cast(Any, self.env.render()))
