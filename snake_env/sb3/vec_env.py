"""The vector environment for Stable-Baselines3 and sb3-contrib."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from snake_env.envs.vector_env import SnakeModeSelectionVectorEnv
from snake_env.errors import InvalidInputError


class SnakeVecEnv(VecEnv):
    """SB3's ``VecEnv`` over :class:`SnakeModeSelectionVectorEnv`.

    ``MaskablePPO`` finds the masks by itself; plain SB3 finds them in the observation with
    ``mask_in_observation``. The info of a robot whose episode ended holds ``terminal_observation``,
    ``TimeLimit.truncated``, ``episode`` (return ``r``, length ``l``, as SB3's ``Monitor`` does),
    ``is_success`` and ``episode_summary``; the others' are empty. ``TimeLimit.truncated`` is always
    False: the reward of a failure at the horizon is final, so learners must not add what a value
    function expects beyond it.

    Args:
        num_envs: Number of robots.
        mask_in_observation: Whether observations are dicts with ``observation`` and ``action_mask``.
        **kwargs: As those of :class:`snake_env.envs.env.SnakeModeSelectionEnv`.

    Raises:
        InvalidInputError: A value that can't be used.
        UnknownNameError: A name that does not exist.
    """

    def __init__(self, num_envs: int, mask_in_observation: bool = False, **kwargs: Any) -> None:
        self.envs = SnakeModeSelectionVectorEnv(num_envs, AutoresetMode.SAME_STEP, **kwargs)
        self.render_mode = self.envs.render_mode
        self.mask_in_observation = mask_in_observation
        observed: spaces.Space[Any] = self.envs.single_observation_space
        n_modes = self.envs.core.masks(np.array([0])).shape[1]
        if mask_in_observation:
            mask = spaces.Box(0, 1, (n_modes,), np.int8)
            observed = spaces.Dict({"observation": observed, "action_mask": mask})
        super().__init__(num_envs, observed, self.envs.single_action_space)
        self._masks = np.ones((num_envs, n_modes), dtype=np.int8)
        self._returns = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, dtype=np.int64)

    def action_masks(self) -> NDArray[np.bool_]:
        """Which modes each robot may choose now, shape (num_envs, n_modes)."""
        return self._masks.astype(np.bool_)

    def reset(self) -> Any:
        """Begins all episodes; seeds and options are those of ``seed()`` and ``set_options()``."""
        seeds = None if all(seed is None for seed in self._seeds) else self._seeds
        options = [option for option in self._options if option]
        if options and any(option != self._options[0] for option in self._options):
            raise InvalidInputError("options", self._options, "the same options for all robots")
        observation, info = self.envs.reset(seed=seeds, options=options[0] if options else None)
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
        self._masks = info["action_mask"]
        return self._observation(observation, self._masks)

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of each robot, for SB3's ``render`` and ``VecVideoRecorder``."""
        return self.envs.render() or [None] * self.num_envs

    def step_async(self, actions: NDArray[Any]) -> None:
        """Takes the actions for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Executes them; robots whose episode ended begin a new one."""
        observation, reward, terminated, truncated, info = self.envs.step(self._actions)
        done = terminated | truncated
        self._returns += reward
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        self._masks = info["action_mask"]
        for k in np.flatnonzero(done).tolist():
            final = info["final_info"]
            last = {key: value[k].copy() for key, value in info.items() if key == "final_obs"}
            infos[k] = {
                "terminal_observation": self._observation(
                    last["final_obs"], final["action_mask"][k]
                ),
                "TimeLimit.truncated": False,
                "episode": {"r": float(self._returns[k]), "l": int(self._lengths[k]), "t": 0.0},
                "is_success": bool(final["is_success"][k]),
                "episode_summary": {
                    name: values[k].item()
                    for name, values in final["episode_summary"].items()
                    if name[0] != "_"
                },
            }
        self._returns[done], self._lengths[done] = 0.0, 0
        return self._observation(observation, self._masks), reward.astype(np.float32), done, infos

    def close(self) -> None:
        """Closes the environment."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of each robot's env, as ``params``."""
        values = self.envs.get_attr(attr_name)
        return [values[k] for k in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets an attribute for all robots.

        Raises:
            InvalidInputError: Only some robots are meant; they share one env.
        """
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise InvalidInputError("indices", indices, "None: the robots share one env")
        setattr(self.envs, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Calls a method of each robot's env: ``action_masks`` or ``render``.

        Raises:
            AttributeError: The robots have no such method.
            TypeError: Arguments are given; these methods take none.
        """
        if args or kwargs:
            raise TypeError(f"{method_name}() takes no arguments")
        rows = self.envs.call(method_name)
        return [rows[k] for k in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Nothing is wrapped; ``episode`` infos are there as if ``Monitor`` were."""
        monitored = wrapper_class.__name__ == "Monitor"
        return [monitored for _ in self._get_indices(indices)]

    def _observation(self, observation: NDArray[np.float32], mask: NDArray[np.int8]) -> Any:
        if not self.mask_in_observation:
            return observation
        return {"observation": observation, "action_mask": mask.copy()}
