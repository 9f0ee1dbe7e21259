"""The Gymnasium environment: a thin adapter over :class:`snake_env.envs.core.EnvCore`."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from snake_env.envs.core import EnvCore, EnvOptions
from snake_env.envs.env_state import EnvState
from snake_env.envs.spaces import action_space, observation_space
from snake_env.envs.transition import OnInfeasible
from snake_env.errors import InvalidInputError, InvalidModeError, UnknownNameError, as_integer
from snake_env.params import SnakeParams
from snake_env.rendering.scenes import FRAMES_PER_SECOND
from snake_env.rendering.viewer import Viewer
from snake_env.sim.lanes import check_states
from snake_env.sim.masks import MaskLevel
from snake_env.state import SnakeState, StateBatch

_ONLY = np.array([0])


class SnakeModeSelectionEnv(gymnasium.Env[NDArray[np.float32], np.int64]):
    r"""Choose which wheels a snake robot lifts, so that it changes its shape and its head stays still.

    ## Description
    A planar snake robot of n + 1 links with passive wheels must turn its n yaw joints from a random
    shape to a target shape. The joints do so one after another from head to tail (phase i turns joint
    i, the SCP), under the controller of M. Tanaka and K. Tanaka, "Shape Control of a Snake Robot with
    Joint Limit and Self-Collision Avoidance", IEEE TCST 25(4), 2017. Every ``delta_t`` = 3 s the agent
    chooses the mode: which wheels behind the SCP are lifted. That decides which redundant motion the
    controller can use to stay clear of the joint limits and of itself, and whether the robot tips.

    ## Action Space
    ``Discrete(n_modes)``, 99 for n = 8: an index in :class:`snake_env.modes.ModeTable`, ordered by the
    number of lifted rear wheels, then lexicographically by wheel number (0 = none, 1..7 = wheel 2..8
    alone, ...). An index means the same wheels in every phase. Which ones may be chosen now is in
    ``info["action_mask"]`` and ``action_masks()``. A choice that lifts the SCP's wheel or one before it
    is a violation (``invalid_mode``); an index outside the space raises ``InvalidModeError``.

    ## Observation Space
    ``Box(-1, 1, (10 n + 19,), float32)``, 99 values for n = 8. Every value is clipped to [-1, 1];
    places are in the head's frame, in which link 0 points along +x.

    | Index (n = 8) | Name | Meaning | Value 1 means |
    |---|---|---|---|
    | 0..7 | ``phi`` | joint angles | phi_limit |
    | 8..15 | ``target`` | target angles | phi_limit |
    | 16..23 | ``error`` | target - phi | 2 phi_limit |
    | 24..31 | ``limit_margin`` | distance to the joint limit | phi_limit |
    | 32..40 | ``phase`` | one-hot, phases 1..n + 1 | yes |
    | 41..41 | ``scp_error`` | the SCP's target - phi | 2 phi_limit |
    | 42..42 | ``ref_start`` | where the SCP's cam curve starts | phi_limit |
    | 43..43 | ``cam_progress`` | time since the phase began | cam_time or more |
    | 44..44 | ``phase_time`` | time since the phase began | 30 s or more |
    | 45..52 | ``last_lifted`` | rear wheels of the last choice | yes |
    | 53..53 | ``last_turn`` | how far the SCP turned in it | 0.5 rad |
    | 54..56 | ``head_error`` | w - w_d | 0.1 m, 0.1 m, 0.5 rad |
    | 57..72 | ``link_direction`` | cos, sin of each link behind the head | 1 |
    | 73..88 | ``link_centre`` | x, y of each link behind the head | 2 l (n + 1) |
    | 89..90 | ``centre_of_gravity`` | x, y | 2 l (n + 1) |
    | 91..98 | ``support_margin`` | reach of the largest support beyond it, 8 directions | 2 l |

    ## Rewards
    The sum of the terms in ``info["reward_terms"]``, weighted by ``reward_weights``:

    | Term | Weight | Times |
    |---|---|---|
    | ``time`` | -0.1 | intervals elapsed |
    | ``success`` | 1.0 | 1 when the target is reached |
    | ``failure`` | -20.0 | 1 when the episode ends otherwise; also pays ``time`` up to the horizon |
    | ``violation`` | 0.0 | 1 when the choice was infeasible or not allowed (learners without masks) |
    | ``cost`` | 0.0 | the mean of V (19) over the interval, 10 at most |
    | ``shaping`` | 0.0 | gamma Phi(after) - Phi(before), Phi = minus the phases left |

    A success in k intervals returns 1 - 0.1 k; every failure returns -30, however and whenever it
    comes. So the mean return ranks policies by success, then by time, and giving up never pays: a
    violation in the first interval costs what a deadlock costs that lasts to the horizon. The shipped
    agents are trained with these weights. The further weight ``gamma`` (0.99) is the agent's discount
    in ``shaping``, which changes no optimal policy.

    ## Starting State
    Phase 1, head at ``w_d``, initial and target shape drawn as in section V of the paper: uniform
    within the joint limits, drawn again where links collide. Or a random row of ``task_suite``.

    ## Episode End
    1. Termination: the target is reached (``is_success``).
    2. Termination: the robot tips (22), a joint passes its limit (23), links touch, or the choice was
       not allowed. With ``on_infeasible="reject"`` infeasible choices are not executed: the robot holds
       still for delta_t instead, and the episode continues.
    3. Truncation: after ``horizon`` = 100 decisions. ``failure`` is final: do not bootstrap there.

    ## Information
    | Key | Type | Meaning |
    |---|---|---|
    | ``action_mask`` | int8 (n_modes,) | 1 for the modes that may be chosen; at least one |
    | ``is_success`` | bool | whether the target is reached |
    | ``violation`` | str | ``""``, ``stability``, ``joint_limit``, ``collision`` or ``invalid_mode`` |
    | ``phase`` | int | 1..n; n + 1 once the target is reached |
    | ``lifted`` | int8 (n,) | wheels in the air during the last interval, the SCP's included |
    | ``reward_terms`` | dict | the weighted terms of the reward |
    | ``elapsed_s`` | float | time since the episode began |
    | ``d_min`` | float | least distance [m] between links that could collide, in the last interval |
    | ``max_abs_phi`` | float | largest joint angle [rad] in the last interval |
    | ``episode_summary`` | dict | at the end only: :class:`snake_env.sim.episode.EpisodeSummary` |

    ## Arguments
    | Parameter | Type | Default | Meaning |
    |---|---|---|---|
    | ``preset`` | str | ``"paper"`` | ``paper``, ``hardware``, ``narrow``, ``six`` or ``ten`` |
    | ``mask_level`` | str | ``"instant"`` | ``structural``, ``instant`` or ``lookahead`` |
    | ``on_infeasible`` | str | ``"terminate"`` | or ``reject`` |
    | ``reward_weights`` | dict | ``None`` | replaces weights by name |
    | ``slip`` | tuple | ``(0.0, 0.0)`` | standard deviation of the head's slip per interval [m, rad] |
    | ``task_suite`` | str | ``None`` | draws tasks from it: any name that ``load_tasks`` takes |
    | ``no_repeat`` | bool | ``False`` | closes modes that were tried since the robot last moved |
    | ``render_mode`` | str | ``None`` | ``human``, ``rgb_array`` or ``rgb_array_list`` |
    | ``**params`` | | | replaces fields of :class:`snake_env.params.SnakeParams` |

    ``reset(options=...)`` takes ``phi0`` and ``target`` (shapes [rad]) and ``task`` (row of the suite).

    ## Version History
    * v0: initial version.

    ## References
    M. Tanaka and K. Tanaka, IEEE Transactions on Control Systems Technology 25(4), 1441-1448, 2017.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # Gymnasium's own declaration
        "render_modes": ["human", "rgb_array", "rgb_array_list"],
        "render_fps": FRAMES_PER_SECOND,
    }

    def __init__(
        self,
        preset: str = "paper",
        mask_level: MaskLevel = "instant",
        on_infeasible: OnInfeasible = "terminate",
        reward_weights: dict[str, float] | None = None,
        slip: Sequence[float] = (0.0, 0.0),
        task_suite: str | None = None,
        no_repeat: bool = False,
        render_mode: str | None = None,
        **params: Any,
    ) -> None:
        options = EnvOptions.parse(
            preset, mask_level, on_infeasible, reward_weights, slip, task_suite, no_repeat, params
        )
        self.core = EnvCore(1, options)
        self.action_space = action_space(options)
        self.observation_space = observation_space(options)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise UnknownNameError("render_mode", str(render_mode), self.metadata["render_modes"])
        self.render_mode = render_mode
        self._viewer: Viewer | None = None
        self._begun = self._running = False

    @property
    def params(self) -> SnakeParams:
        """The constants of the robot."""
        return self.core.options.params

    @property
    def state(self) -> SnakeState:
        """The robot's state (a copy)."""
        return self.core.states[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins an episode.

        Args:
            seed: Seeds the env's source of randomness.
            options: ``phi0``, ``target``: shapes (n,) [rad]; ``task``: a row of the task suite.

        Raises:
            UnknownNameError: An option that does not exist.
            InvalidInputError: A shape or a task that can't be used.
        """
        super().reset(seed=seed)
        info = self.core.reset(_ONLY, [self.np_random], options)
        self._begun = self._running = True
        if self.render_mode is not None:
            self._view().begin(self.state)
        return self.core.observe(_ONLY)[0], _only(info)

    def step(
        self, action: np.int64 | int
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Executes a mode for one interval.

        Raises:
            InvalidModeError: The mode is not in the action space.
            gymnasium.error.ResetNeeded: No episode is running.
        """
        if not self._running:
            raise gymnasium.error.ResetNeeded("no episode is running: call reset()")
        before, mode = self.state, as_integer(action)
        if mode is None:
            raise InvalidModeError("action", action, f"an integer below {len(self.action_masks())}")
        result = self.core.step(_ONLY, np.array([mode]), [self.np_random])
        terminated, truncated = bool(result.terminated[0]), bool(result.truncated[0])
        info = _only(result.info)
        if terminated or truncated:
            self._running = False
            info["episode_summary"] = dataclasses.asdict(self.core.episodes.summary(0))
        if self.render_mode is not None:
            self._view().show(before, mode, self.state, info["violation"])
        return self.core.observe(_ONLY)[0], float(result.reward[0]), terminated, truncated, info

    def action_masks(self) -> NDArray[np.bool_]:
        """Which modes may be chosen now, shape (n_modes,): at least one, all after a success."""
        mask: NDArray[np.bool_] = self.core.masks(_ONLY)[0]
        return mask

    def get_state(self) -> EnvState:
        """Everything that the env's future depends on, for :meth:`set_state`."""
        core, rng = self.core, self.np_random
        saved = EnvState(core.states, core.episodes, core.no_repeat, rng, self._running)
        return copy.deepcopy(saved)

    def set_state(self, state: EnvState | SnakeState) -> None:
        """Goes back to what :meth:`get_state` of such an env returned, or begins in a robot's state.

        Raises:
            InvalidInputError: It is neither, or of an env with other constants or ``no_repeat``.
        """
        if isinstance(state, SnakeState):
            batch = StateBatch.stack([state])
            check_states(batch, self.params)
            self.core.restart(_ONLY, batch)
            self._running = not state.done
        elif not isinstance(state, EnvState):
            raise InvalidInputError("state", state, "what get_state() returned, or a SnakeState")
        else:
            state.check(self.params, no_repeat=self.core.no_repeat is not None)
            saved = copy.deepcopy(state)
            self.core.states, self.core.episodes = saved.states, saved.episodes
            self.core.no_repeat = saved.no_repeat
            self.np_random, self._running = saved.rng, saved.running
        self._begun = True
        if self.render_mode is not None:
            self._view().begin(self.state)

    def render(self) -> Any:
        """What the render mode asks for.

        Returns:
            ``rgb_array``: the last frame, (480, 640, 3) uint8. ``rgb_array_list``: the frames of the
            motion since the last call. ``human``: None; the window shows the motion by itself.

        Raises:
            MissingDependencyError: Pillow (or pygame, for ``human``) is not installed.
            gymnasium.error.ResetNeeded: No episode has begun yet.
        """
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() needs gym.make(..., render_mode='rgb_array') or the like"
            )
            return None
        if not self._begun:
            raise gymnasium.error.ResetNeeded("there is nothing to show yet: call reset()")
        if self.render_mode == "rgb_array_list":
            return self._view().take()
        return self._view().frame() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Closes the window, if there is one."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def __getstate__(self) -> dict[str, Any]:
        """All but the viewer, which a copy makes again."""
        return {**self.__dict__, "_viewer": None}

    def _view(self) -> Viewer:
        if self._viewer is None:
            assert self.render_mode is not None
            self._viewer = Viewer(self.params, self.render_mode)
            self._viewer.begin(self.state)
        return self._viewer


def _only(info: dict[str, Any]) -> dict[str, Any]:
    """The first robot's row of each entry, as plain values; arrays stay arrays."""
    first: dict[str, Any] = {}
    for key, value in info.items():
        if isinstance(value, dict):
            first[key] = _only(value)
        else:
            first[key] = value[0] if value.ndim > 1 else value[0].item()
    return first
