"""The vector environment: many robots in one pass of the kernel."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from snake_env.envs.core import EnvCore, EnvOptions
from snake_env.envs.env import SnakeModeSelectionEnv
from snake_env.envs.per_robot import of_each_robot
from snake_env.envs.spaces import action_space, observation_space
from snake_env.envs.transition import OnInfeasible
from snake_env.errors import InvalidInputError, InvalidModeError, UnknownNameError, as_integer
from snake_env.params import SnakeParams
from snake_env.rendering.painter import Painter
from snake_env.rendering.scenes import still_scene
from snake_env.sim.masks import MaskLevel
from snake_env.sim.slip import NO_SLIP, slip_of_each
from snake_env.state import FloatArray, IntArray

Info = dict[str, Any]


class SnakeModeSelectionVectorEnv(VectorEnv[NDArray[np.float32], IntArray, NDArray[Any]]):
    """``num_envs`` robots, each of which does bit for bit what it would do in an env of its own.

    Made by ``gymnasium.make_vec("snake_env:SnakeModeSelection-v0", num_envs=...)``. It behaves as
    ``SyncVectorEnv`` over :class:`snake_env.envs.env.SnakeModeSelectionEnv` does, only faster:
    ``reset(seed=s)`` gives robot k what a single env gets from ``reset(seed=s + k)``, and an entry
    ``key`` of the info is an array over the robots, with ``_key`` marking those that have it.

    Args:
        num_envs: Number of robots.
        autoreset_mode: ``NEXT_STEP``, ``SAME_STEP`` or ``DISABLED``, as Gymnasium defines them.
        render_mode: ``rgb_array``, or None. The pictures show the robots at their t_k; the motion in
            between is drawn by the single env only.
        slip: As that of the single env, or one for each robot, shape (num_envs, 2).
        **others: As those of :class:`snake_env.envs.env.SnakeModeSelectionEnv`.

    Raises:
        InvalidInputError: A value that can't be used.
        UnknownNameError: A name that does not exist.
    """

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        preset: str = "paper",
        mask_level: MaskLevel = "instant",
        on_infeasible: OnInfeasible = "terminate",
        reward_weights: dict[str, float] | None = None,
        slip: Sequence[float] | FloatArray = (0.0, 0.0),
        task_suite: str | None = None,
        no_repeat: bool = False,
        render_mode: str | None = None,
        **params: Any,
    ) -> None:
        count = as_integer(num_envs)
        if count is None or count < 1:
            raise InvalidInputError("num_envs", num_envs, "a positive integer")
        autoreset_modes = [mode.value for mode in AutoresetMode]
        if autoreset_mode not in (*AutoresetMode, *autoreset_modes):
            raise UnknownNameError("autoreset_mode", str(autoreset_mode), autoreset_modes)
        if render_mode not in (None, "rgb_array"):
            expected = "'rgb_array' or None; a single env has the other modes"
            raise InvalidInputError("render_mode", render_mode, expected)
        slips = slip_of_each(slip, count)
        shared = slip if slips is None else NO_SLIP
        options = EnvOptions.parse(
            preset, mask_level, on_infeasible, reward_weights, shared, task_suite, no_repeat, params
        )
        self.num_envs = count
        self.core = EnvCore(count, options, slips)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {
            **SnakeModeSelectionEnv.metadata,
            "render_modes": ["rgb_array"],
            "autoreset_mode": self.autoreset_mode,
        }
        self.render_mode = render_mode
        self.single_action_space = action_space(options)
        self.single_observation_space = observation_space(options)
        self.action_space = batch_space(self.single_action_space, count)
        self.observation_space = batch_space(self.single_observation_space, count)
        self._all = np.arange(count)
        drawn = [seeding.np_random(None) for _ in range(count)]
        self._rngs, self._seeds = [rng for rng, _ in drawn], [seed for _, seed in drawn]
        self._painters: list[Painter] = []
        self._ended = np.zeros(count, dtype=np.bool_)
        self._begun = False
        self._observations = np.zeros(self.observation_space.shape or (), dtype=np.float32)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Info | None = None
    ) -> tuple[NDArray[np.float32], Info]:
        """Begins episodes.

        Args:
            seed: A seed for each robot, or one from which they count upwards.
            options: As those of the single env, for all robots; ``reset_mask``: which robots to
                reset, shape (num_envs,), bool.

        Raises:
            InvalidInputError: As many seeds as robots are needed; or a shape or task can't be used.
            UnknownNameError: An option that does not exist.
        """
        if not isinstance(options, Mapping | None):
            raise InvalidInputError("options", options, "a dict")
        given = dict(options or {})
        mask = given.pop("reset_mask", None)
        chosen = self._all if mask is None else np.flatnonzero(self._checked_mask(mask))
        if not self._begun and len(chosen) < self.num_envs:
            raise InvalidInputError("reset_mask", mask, "all robots at the first reset")
        if seed is None:
            seeds: Sequence[int | None] = [None] * self.num_envs
        else:
            first = as_integer(seed)
            if first is not None:
                seeds = [first + k for k in range(self.num_envs)]
            elif isinstance(seed, Sequence):
                seeds = seed
            else:
                raise InvalidInputError("seed", seed, "an integer, or one for each robot")
        if len(seeds) != self.num_envs:
            raise InvalidInputError("seed", len(seeds), f"{self.num_envs} seeds")
        for k in chosen.tolist():
            if seeds[k] is not None:
                self._rngs[k], self._seeds[k] = seeding.np_random(seeds[k])
        info: Info = {}
        self._restart(chosen, info, given)
        self._begun = True
        return self._observations.copy(), info

    def step(
        self, actions: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any], Info]:
        """Executes a mode for each robot whose episode is running, and resets the others.

        Args:
            actions: Mode indices, shape (num_envs,).

        Raises:
            InvalidModeError: A mode is not in the action space.
            InvalidInputError: The wrong number of actions.
        """
        if not self._begun:
            raise ResetNeeded("no episode is running: call reset()")
        try:
            given = np.asarray(actions)
        except ValueError:  # ragged
            expected = f"one mode index for each of {self.num_envs} robots"
            raise InvalidModeError("actions", actions, expected) from None
        if given.shape != (self.num_envs,):
            raise InvalidInputError("actions.shape", given.shape, f"({self.num_envs},)")
        if given.dtype.kind not in "iu":
            raise InvalidModeError("actions", given.tolist(), "integers")
        modes = given.astype(np.int64)
        reward = np.zeros(self.num_envs)
        terminated = np.zeros(self.num_envs, dtype=np.bool_)
        truncated = np.zeros(self.num_envs, dtype=np.bool_)
        info: Info = {}
        waiting = np.flatnonzero(self._ended)
        if len(waiting) and self.autoreset_mode == AutoresetMode.DISABLED:
            raise InvalidInputError("actions", waiting.tolist(), "a reset of these robots first")
        moving = np.flatnonzero(~self._ended)
        if len(moving):
            result = self.core.step(moving, modes[moving], self._some(moving))
            reward[moving] = result.reward
            terminated[moving], truncated[moving] = result.terminated, result.truncated
            self._observations[moving] = self.core.observe(moving)
            self._merge(info, result.info, moving)
        if len(waiting):  # NEXT_STEP: these ended in the last step
            self._restart(waiting, info, None)
        self._ended = terminated | truncated
        self._finish(info)
        return self._observations.copy(), reward, terminated, truncated, info

    def action_masks(self) -> NDArray[np.bool_]:
        """Which modes each robot may choose now, shape (num_envs, n_modes)."""
        return self.core.masks(self._all)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture of each robot, (480, 640, 3) uint8, with ``render_mode="rgb_array"``; else None.

        Raises:
            MissingDependencyError: Pillow is not installed.
            gymnasium.error.ResetNeeded: No episode has begun yet.
        """
        if self.render_mode is None:
            return None
        if not self._begun:
            raise ResetNeeded("there is nothing to show yet: call reset()")
        params = self.core.options.params
        if not self._painters:
            self._painters = [Painter(params) for _ in range(self.num_envs)]
        return tuple(
            painter.frame(still_scene(self.core.states[k], params))
            for k, painter in enumerate(self._painters)
        )

    def call(self, name: str) -> tuple[Any, ...]:
        """A method's result or an attribute of each robot, as ``SyncVectorEnv.call`` gives them.

        Raises:
            AttributeError: The robots have none of this name.
        """
        return of_each_robot(self, name)

    get_attr = call

    @property
    def params(self) -> SnakeParams:
        """The constants of the robots."""
        return self.core.options.params

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Each robot's source of randomness."""
        return tuple(self._rngs)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """What each of them was seeded with last."""
        return tuple(self._seeds)

    def _finish(self, info: Info) -> None:
        """Adds the summaries of the episodes that ended, and resets them in SAME_STEP mode."""
        over = np.flatnonzero(self._ended)
        if len(over) == 0:
            return
        self._merge(info, {"episode_summary": self.core.episodes.columns(over)}, over)
        if self.autoreset_mode != AutoresetMode.SAME_STEP:
            return
        ended = self._ended.copy()
        final_obs = np.full(self.num_envs, None, dtype=object)
        for k in over.tolist():
            final_obs[k] = self._observations[k].copy()
        ended_info = {key: _rows(value, over) for key, value in info.items() if key[0] != "_"}
        self._restart(over, info, None)
        self._merge(info, {"final_info": ended_info}, over)
        info["final_obs"], info["_final_obs"] = final_obs, ended
        for key in ("episode_summary", "_episode_summary"):  # now part of final_info
            del info[key]

    def _restart(self, indices: IntArray, info: Info, options: Info | None) -> None:
        begun = self.core.reset(indices, self._some(indices), options)
        self._observations[indices] = self.core.observe(indices)
        self._ended[indices] = False
        self._merge(info, begun, indices)

    def _some(self, indices: IntArray) -> list[np.random.Generator]:
        return [self._rngs[k] for k in indices.tolist()]

    def _merge(self, info: Info, rows: Info, indices: IntArray) -> None:
        """Puts the rows of some robots into the info of all, Gymnasium's way."""
        for key, value in rows.items():
            marked = info.setdefault(f"_{key}", np.zeros(self.num_envs, dtype=np.bool_))
            marked[indices] = True
            if isinstance(value, dict):
                self._merge(info.setdefault(key, {}), value, indices)
                continue
            if key not in info:
                info[key] = np.zeros((self.num_envs, *value.shape[1:]), dtype=value.dtype)
            info[key][indices] = value

    def _checked_mask(self, mask: Any) -> NDArray[np.bool_]:
        array = np.asarray(mask)
        if array.shape != (self.num_envs,) or array.dtype != np.bool_ or not array.any():
            expected = f"({self.num_envs},) of bool with a True entry"
            raise InvalidInputError("options['reset_mask']", mask, expected)
        return array

    def __deepcopy__(self, memo: dict[int, Any]) -> SnakeModeSelectionVectorEnv:
        twin = copy.copy(self)
        twin.__dict__.update(
            {
                name: copy.deepcopy(getattr(self, name), memo)
                for name in ("core", "_rngs", "_seeds", "_ended", "_observations")
            }
        )
        twin._painters = []
        return twin

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_painters": []}


def _rows(value: Any, indices: IntArray) -> Any:
    if isinstance(value, dict):
        return {key: _rows(inner, indices) for key, inner in value.items() if key[0] != "_"}
    return value[indices]
