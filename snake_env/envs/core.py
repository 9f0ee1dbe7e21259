"""What the env and the vector env share: N robots, their episodes, rewards and infos.

The env is the case N = 1, so that both do the same bit for bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from snake_env.envs.no_repeat import NoRepeat
from snake_env.envs.reward import RewardWeights, reward_terms
from snake_env.envs.transition import OnInfeasible, transition
from snake_env.errors import InvalidInputError, UnknownNameError, as_finite, as_integer
from snake_env.modes import mode_table
from snake_env.params import LARGEST, SnakeParams
from snake_env.sim.episode import Episodes
from snake_env.sim.masks import MaskLevel, action_masks, check_mask_level
from snake_env.sim.observation import observe_unchecked
from snake_env.sim.slip import check_slip, slipped
from snake_env.sim.tasks import TaskSuite, load_tasks, random_tasks
from snake_env.state import FloatArray, IntArray, StateBatch, checked_shape

RESET_OPTIONS = ("phi0", "target", "task")


@dataclass(frozen=True)
class EnvOptions:
    """Keyword arguments of the env, checked; see :class:`snake_env.envs.env.SnakeModeSelectionEnv`."""

    params: SnakeParams
    mask_level: MaskLevel
    on_infeasible: OnInfeasible
    weights: RewardWeights
    slip: tuple[float, float]
    suite: TaskSuite | None
    no_repeat: bool

    @classmethod
    def parse(
        cls,
        preset: str,
        mask_level: MaskLevel,
        on_infeasible: OnInfeasible,
        reward_weights: dict[str, float] | None,
        slip: Sequence[float] | FloatArray,
        task_suite: str | None,
        no_repeat: bool,
        params: dict[str, Any],
    ) -> EnvOptions:
        """Checks the keyword arguments.

        Raises:
            UnknownNameError: A name that does not exist, with a suggestion.
            InvalidInputError: A value that can't be used.
        """
        if "max_episode_steps" in params:
            given = params["max_episode_steps"]
            raise InvalidInputError(
                "max_episode_steps", given, f"none; use horizon={given} instead"
            )
        constants = SnakeParams.preset(preset, **params)
        if not isinstance(no_repeat, bool):
            raise InvalidInputError("no_repeat", no_repeat, "True or False")
        check_mask_level(mask_level)
        if on_infeasible not in get_args(OnInfeasible):
            raise UnknownNameError("on_infeasible", on_infeasible, get_args(OnInfeasible))
        suite = None if task_suite is None else load_tasks(task_suite, constants)
        weights = checked_weights({} if reward_weights is None else reward_weights)
        return cls(
            constants, mask_level, on_infeasible, weights, check_slip(slip), suite, no_repeat
        )


def checked_weights(given: Any) -> RewardWeights:
    """The weights of the reward's terms, of which some are given by name.

    Raises:
        UnknownNameError: A term does not exist.
        InvalidInputError: A weight is no finite number.
    """
    if not isinstance(given, Mapping):
        raise InvalidInputError("reward_weights", given, "a dict of weights by name")
    known = [field.name for field in dataclasses.fields(RewardWeights)]
    numbers = {}
    for name, weight in given.items():
        if name not in known:
            raise UnknownNameError("reward term", name, known)
        number = as_finite(weight)
        if number is None or abs(number) > LARGEST:
            expected = f"a finite number, at most {LARGEST:g} in size"
            raise InvalidInputError(f"reward_weights[{name!r}]", weight, expected)
        numbers[name] = number
    weights = RewardWeights(**numbers)
    if not 0.0 <= weights.gamma <= 1.0:
        raise InvalidInputError("reward_weights['gamma']", weights.gamma, "a discount, 0 to 1")
    return weights


@dataclass(frozen=True, eq=False)
class StepResult:
    """What N transitions gave: rewards (N,), terminations, truncations (N,), and infos."""

    reward: FloatArray
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    info: dict[str, Any]


class EnvCore:
    """N robots.

    Args:
        count: N.
        options: The keyword arguments, checked.
        slips: How much each robot slips, shape (N, 2) [m, rad]; default: as the options say.

    Attributes:
        options: The keyword arguments, checked.
        states: Where the robots are.
        episodes: Their episodes.
        no_repeat: What they have tried where they stand still; None where the rule is off.
    """

    def __init__(self, count: int, options: EnvOptions, slips: FloatArray | None = None) -> None:
        self.options = options
        self._slips = slips
        shapes = np.zeros((count, options.params.n_joints))
        self.states = StateBatch.initial(shapes, shapes, options.params)
        self.episodes = Episodes(self.states, options.params)
        n_modes = len(mode_table(options.params.n_joints))
        self.no_repeat = NoRepeat(count, n_modes) if options.no_repeat else None

    def reset(
        self,
        indices: IntArray,
        rngs: Sequence[np.random.Generator],
        options: dict[str, Any] | None = None,
    ) -> dict[str, Any]:
        """Begins the episodes at the given positions; their infos.

        Args:
            indices: Positions, shape (K,).
            rngs: Their sources of randomness.
            options: ``phi0``, ``target``: shapes (n,) [rad]; ``task``: a row of the task suite.

        Raises:
            UnknownNameError: An option that does not exist.
            InvalidInputError: A shape or a task that can't be used.
        """
        params, given = self.options.params, {} if options is None else options
        if not isinstance(given, Mapping):
            raise InvalidInputError("options", given, "a dict of reset options")
        for name in given:
            if name not in RESET_OPTIONS:
                raise UnknownNameError("reset option", name, RESET_OPTIONS)
        shapes = {name: value for name, value in given.items() if name != "task"}
        fixed = {name: checked_shape(name, shape, params) for name, shape in shapes.items()}
        phi0, target = self._tasks(rngs, given.get("task"))
        phi0[:] = fixed.get("phi0", phi0)
        target[:] = fixed.get("target", target)
        begun = StateBatch.initial(phi0, target, params)
        self.restart(indices, begun)
        count = len(indices)
        terms = [f.name for f in dataclasses.fields(RewardWeights) if f.name != "gamma"]
        return self._info(
            indices,
            violation=np.zeros(count, dtype="<U12"),
            lifted=np.zeros((count, params.n_joints), dtype=np.int8),
            terms={name: np.zeros(count) for name in terms},
            d_min=self.episodes.d_min(indices),
            max_abs_phi=np.abs(phi0).max(axis=1),
        )

    def restart(self, indices: IntArray, states: StateBatch) -> None:
        """Begins episodes at the given positions; intervals that the states have behind them count."""
        self.states = self.states.put(indices, states)
        behind = np.rint(states.elapsed / self.options.params.delta_t).astype(np.int64)
        self.episodes.restart(indices, states, behind)
        if self.no_repeat is not None:
            self.no_repeat.restart(indices, states)

    def _tasks(
        self, rngs: Sequence[np.random.Generator], task: int | None
    ) -> tuple[FloatArray, FloatArray]:
        suite, params = self.options.suite, self.options.params
        if suite is None:
            if task is not None:
                raise InvalidInputError("options['task']", task, "an env with a task_suite")
            return random_tasks(rngs, params)
        if task is None:
            rows = [int(rng.integers(len(suite))) for rng in rngs]
        elif (row := as_integer(task)) is not None and 0 <= row < len(suite):
            rows = [row] * len(rngs)
        else:
            raise InvalidInputError("options['task']", task, f"a row from 0 to {len(suite) - 1}")
        return suite.phi0[rows], suite.target[rows]

    def step(
        self, indices: IntArray, modes: IntArray, rngs: Sequence[np.random.Generator]
    ) -> StepResult:
        """Executes a mode for the robots at the given positions.

        Args:
            indices: Positions, shape (K,), of episodes that have not ended.
            modes: Mode indices, shape (K,).
            rngs: Their sources of randomness, for the slip.

        Raises:
            InvalidModeError: A mode is not in the table.
        """
        options, params = self.options, self.options.params
        before = self.states.take(indices)
        moved = transition(before, modes, options.on_infeasible, params)
        after, prediction = moved.after, moved.prediction
        slip = options.slip if self._slips is None else self._slips[indices]
        after = dataclasses.replace(after, w=slipped(after.w, slip, rngs))
        self.states = self.states.put(indices, after)
        self.episodes.record(indices, after, prediction)
        if self.no_repeat is not None:
            self.no_repeat.record(indices, modes, after)
        outcome = self.episodes.outcome[indices]
        truncated = (outcome == "deadlock") | (outcome == "horizon")
        terminated = (outcome != "") & ~truncated
        terms = reward_terms(before, after, prediction, outcome, options.weights, params)
        lifted = mode_table(params.n_joints).lifted_wheels(modes, before.phase)
        lifted &= moved.executed[:, None]
        info = self._info(
            indices,
            violation=np.where(outcome == "collision", "collision", moved.violation),
            lifted=lifted.astype(np.int8),
            terms=terms,
            d_min=prediction.d_min,
            max_abs_phi=prediction.max_abs_phi,
        )
        reward: FloatArray = np.zeros(len(modes))
        for values in terms.values():
            reward = reward + values
        return StepResult(reward, terminated, truncated, info)

    def observe(self, indices: IntArray) -> NDArray[np.float32]:
        """Observations of the robots at the given positions, shape (K, size)."""
        return observe_unchecked(self.states.take(indices), self.options.params)

    def masks(self, indices: IntArray) -> NDArray[np.bool_]:
        """Which modes they may choose, shape (K, n_modes): at least one each, all after a success."""
        states = self.states.take(indices)
        masks = action_masks(states, self.options.params, self.options.mask_level)
        if self.no_repeat is not None:
            masks = self.no_repeat.without_tried(indices, masks)
        masks[states.phase > self.options.params.n_joints] = True
        return masks

    def _info(
        self,
        indices: IntArray,
        *,
        violation: NDArray[np.str_],
        lifted: NDArray[np.int8],
        terms: dict[str, NDArray[Any]],
        d_min: FloatArray,
        max_abs_phi: FloatArray,
    ) -> dict[str, Any]:
        """Infos of the robots at the given positions: arrays with a row each."""
        return {
            "action_mask": self.masks(indices).astype(np.int8),
            "is_success": self.episodes.outcome[indices] == "success",
            "violation": violation,
            "phase": self.states.phase[indices],
            "lifted": lifted,
            "reward_terms": terms,
            "elapsed_s": self.states.elapsed[indices],
            "d_min": d_min,
            "max_abs_phi": max_abs_phi,
        }
