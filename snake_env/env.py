"""The Gymnasium environment: a thin adapter over :func:`snake_env.simulation.advance`."""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from snake_env.episode import Episode
from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.kinematics import d_min
from snake_env.masks import MaskLevel, action_masks, check_mask_level
from snake_env.modes import mode_table
from snake_env.observation import observation_size, observe
from snake_env.params import SnakeParams
from snake_env.reward import RewardWeights, reward_terms
from snake_env.simulation import advance
from snake_env.state import SnakeState, StateBatch
from snake_env.tasks import random_task


class SnakeModeSelectionEnv(gymnasium.Env[NDArray[np.float32], np.int64]):
    """Choose which wheels a snake robot lifts, so that it changes its shape and its head stays still.

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
    alone, ...). An index means the same wheels in every phase. Which ones are allowed now is in
    ``info["action_mask"]`` and ``action_masks()``; any other raises ``InvalidModeError``.

    ## Observation Space
    ``Box(-1, 1, (8 n + 9,), float32)``, 73 values for n = 8. Every row is clipped to [-1, 1]; places
    are in the head's frame, in which link 0 points along +x.

    | Index (n = 8) | Meaning | Unit of 1.0 |
    |---|---|---|
    | 0..7 | ``phi``: joint angles | phi_limit |
    | 8..15 | ``target``: target angles | phi_limit |
    | 16..23 | ``error``: target - phi | 2 phi_limit |
    | 24..32 | ``phase``: one-hot, phases 1..n + 1 | |
    | 33 | ``scp_error``: the SCP's target - phi | 2 phi_limit |
    | 34 | ``ref_start``: where the SCP's cam curve starts | phi_limit |
    | 35 | ``phase_time``: time since the phase began | 30 s |
    | 36..38 | ``head_error``: w - w_d | 0.1 m, 0.1 m, 0.5 rad |
    | 39..54 | ``link_direction``: cos, sin of each link behind the head | |
    | 55..70 | ``link_centre``: x, y of each link behind the head | 2 l (n + 1) |
    | 71..72 | ``centre_of_gravity``: x, y | 2 l (n + 1) |

    ## Rewards
    The sum of the terms in ``info["reward_terms"]``, weighted by ``reward_weights``:

    | Term | Weight | Times |
    |---|---|---|
    | ``time`` | -0.02 | intervals elapsed |
    | ``phase`` | 0.1 | phases completed |
    | ``success`` | 1.0 | 1 when the target is reached |
    | ``violation`` | -1.0 | 1 when (22) or (23) is broken, or links touch |
    | ``cost`` | -0.002 | the mean of V (19) over the interval |

    ## Starting State
    Phase 1, head at ``w_d``, initial and target shape drawn as in section V of the paper: uniform
    within the joint limits, drawn again where links collide.

    ## Episode End
    1. Termination: the target is reached (``is_success``).
    2. Termination: the robot tips (22), a joint passes its limit (23), or links touch.
    3. Truncation: after ``horizon`` = 100 decisions.

    ## Information
    ``action_mask`` (int8, n_modes), ``is_success``, ``violation`` (``""``, ``"stability"``,
    ``"joint_limit"`` or ``"collision"``), ``phase``, ``lifted`` (all lifted wheels' numbers during the
    last interval), ``reward_terms``, ``elapsed_s``, ``d_min`` [m] and ``max_abs_phi`` [rad] of the last
    interval; when the episode has ended, ``episode_summary``: the fields of
    :class:`snake_env.episode.EpisodeSummary`.

    ## Arguments
    | Parameter | Type | Default | Meaning |
    |---|---|---|---|
    | ``preset`` | str | ``"paper"`` | ``paper``, ``hardware`` or ``narrow`` |
    | ``mask_level`` | str | ``"instant"`` | ``structural``, ``instant`` or ``lookahead`` |
    | ``reward_weights`` | dict | None | replaces weights by name |
    | ``**params`` | | | replaces fields of :class:`snake_env.params.SnakeParams` |

    ``reset(options={"phi0": ..., "target": ...})`` sets the initial and the target shape [rad].

    ## Version History
    * v0: initial version.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # Gymnasium's own declaration

    def __init__(
        self,
        preset: str = "paper",
        mask_level: MaskLevel = "instant",
        reward_weights: dict[str, float] | None = None,
        render_mode: None = None,
        **params: Any,
    ) -> None:
        self.params = SnakeParams.preset(preset, **params)
        check_mask_level(mask_level)
        self.mask_level = mask_level
        known = [field.name for field in dataclasses.fields(RewardWeights)]
        for name in reward_weights or {}:
            if name not in known:
                raise UnknownNameError("reward term", name, known)
        self.reward_weights = RewardWeights(**(reward_weights or {}))
        if render_mode is not None:
            raise InvalidInputError("render_mode", render_mode, "None")
        self.render_mode = render_mode
        self._table = mode_table(self.params.n_joints)
        self.action_space = spaces.Discrete(len(self._table))
        shape = (observation_size(self.params.n_joints),)
        self.observation_space = spaces.Box(-1.0, 1.0, shape, np.float32)
        self._state: SnakeState | None = None

    @property
    def state(self) -> SnakeState:
        """The robot's state.

        Raises:
            gymnasium.error.ResetNeeded: The env has not been reset yet.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() first")
        return self._state

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins an episode with a random task, or with the shapes given in ``options``.

        Raises:
            UnknownNameError: An option that does not exist.
            InvalidInputError: A shape that can't be used.
        """
        super().reset(seed=seed)
        given = options or {}
        for name in given:
            if name not in ("phi0", "target"):
                raise UnknownNameError("reset option", name, ("phi0", "target"))
        phi0, target = random_task(self.np_random, self.params)
        phi0, target = given.get("phi0", phi0), given.get("target", target)
        self._state = SnakeState.initial(phi0, target, self.params)
        self._episode = Episode(self._state, self.params)
        info = self._info()
        return self._observation(), info

    def step(
        self, action: np.int64 | int
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Executes a mode for one interval.

        Raises:
            InvalidModeError: The mode is out of range or not valid in the phase.
            gymnasium.error.ResetNeeded: The episode has not begun, or has ended.
        """
        before = self.state
        if self._episode.ended:
            raise gymnasium.error.ResetNeeded("the episode has ended: call reset()")
        mode = int(action)
        self._state, prediction = advance(before, mode, self.params)
        self._episode.record(self._state, prediction)
        batches = StateBatch.stack([before]), StateBatch.stack([self._state])
        terms = reward_terms(*batches, prediction, self.reward_weights, self.params)
        named = {name: float(values[0]) for name, values in terms.items()}
        outcome = self._episode.outcome
        truncated = outcome in ("deadlock", "horizon")
        terminated = bool(outcome) and not truncated
        info = self._info()
        info.update(
            lifted=[before.phase, *(int(wheel) for wheel in self._table.wheels[mode] if wheel)],
            reward_terms=named,
            d_min=float(prediction.d_min[0]),
            max_abs_phi=float(prediction.max_abs_phi[0]),
            violation=outcome if terminated and outcome != "success" else "",
        )
        if outcome:
            info["episode_summary"] = dataclasses.asdict(self._episode.summary())
        return self._observation(), sum(named.values()), terminated, truncated, info

    def action_masks(self) -> NDArray[np.bool_]:
        """Which modes may be chosen now, shape (n_modes,); always at least one.

        Once the episode has ended by success every mode is marked, as nothing depends on it.
        """
        if self.state.done:
            return np.ones(len(self._table), dtype=np.bool_)
        mask: NDArray[np.bool_] = action_masks(
            StateBatch.stack([self.state]), self.mask_level, self.params
        )[0]
        return mask

    def _observation(self) -> NDArray[np.float32]:
        observation: NDArray[np.float32] = observe(StateBatch.stack([self.state]), self.params)[0]
        return observation

    def _info(self) -> dict[str, Any]:
        state = self.state
        return {
            "action_mask": self.action_masks().astype(np.int8),
            "is_success": self._episode.outcome == "success",
            "violation": "",
            "phase": state.phase,
            "lifted": [],
            "reward_terms": {},
            "elapsed_s": state.elapsed,
            "d_min": d_min(state.phi, self.params.l),
            "max_abs_phi": float(np.abs(state.phi).max()),
        }
