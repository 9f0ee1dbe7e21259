"""The vector env answers what SyncVectorEnv answers, and says what it does not take."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from snake_env import InvalidInputError, InvalidModeError
from snake_env.envs import SnakeModeSelectionEnv, SnakeModeSelectionVectorEnv

ID = "snake_env:SnakeModeSelection-v0"


def _both() -> tuple[Any, Any]:
    fast = SnakeModeSelectionVectorEnv(3)
    slow = gymnasium.vector.SyncVectorEnv([SnakeModeSelectionEnv for _ in range(3)])
    fast.reset(seed=5)
    slow.reset(seed=5)
    return fast, slow


@pytest.mark.parametrize("name", ["params", "render_mode", "action_space", "np_random_seed"])
def test_attributes__are_those_of_single_envs(name: str) -> None:
    fast, slow = _both()
    assert fast.get_attr(name) == slow.get_attr(name)
    assert fast.call(name) == slow.call(name)


def test_masks_seeds_and_states__are_called_robot_by_robot() -> None:
    fast, slow = _both()
    for one, other in zip(fast.call("action_masks"), slow.call("action_masks"), strict=True):
        assert np.array_equal(one, other)
    for one, other in zip(fast.get_attr("state"), slow.get_attr("state"), strict=True):
        assert np.array_equal(one.phi, other.phi)
    assert fast.np_random_seed == slow.np_random_seed == (5, 6, 7)
    assert len(fast.np_random) == 3
    unseeded = SnakeModeSelectionVectorEnv(2).np_random_seed
    assert len(set(unseeded)) == 2
    fast.reset(seed=[1, None, 9])
    assert fast.np_random_seed == (1, 6, 9)


@pytest.mark.parametrize("name", ["action_mask", "core", "reset", "__dict__"])
def test_attribute__that_no_robot_has_is_named(name: str) -> None:
    with pytest.raises(AttributeError, match=f"{name!r}.*known: action_masks"):
        SnakeModeSelectionVectorEnv(2).get_attr(name)


@pytest.mark.parametrize("steps", [1, 50])
def test_max_episode_steps__points_to_horizon(steps: int) -> None:
    with pytest.raises(InvalidInputError, match=rf"expected none; use horizon={steps} instead$"):
        gymnasium.make_vec(ID, num_envs=2, max_episode_steps=steps)
    with pytest.raises(InvalidInputError, match="horizon"):
        SnakeModeSelectionEnv(max_episode_steps=steps)
    env = gymnasium.make(ID, max_episode_steps=steps)  # Gymnasium's own wrapper
    env.reset(seed=0)
    assert env.spec is not None
    assert env.spec.max_episode_steps == steps


@pytest.mark.parametrize(
    "actions",
    [
        [[1], [2, 3]],
        [[1, 2], 3],
        ["a", "b"],
        [None, 1],
        [1.0, 2.0],
        [True, False],
        [1, 99],
        [-1, 0],
    ],
)
def test_actions__of_the_wrong_kind_get_a_typed_error(actions: Any) -> None:
    envs = SnakeModeSelectionVectorEnv(2)
    envs.reset(seed=0)
    with pytest.raises(InvalidModeError, match=r"^actions? = "):
        envs.step(actions)


@pytest.mark.parametrize("actions", [[1], [1, 2, 3], [[1, 2]], 1, []])
def test_actions__of_the_wrong_number_get_a_typed_error(actions: Any) -> None:
    envs = SnakeModeSelectionVectorEnv(2)
    envs.reset(seed=0)
    with pytest.raises(InvalidInputError, match=r"^actions\.shape = "):
        envs.step(actions)


def test_first_reset__is_of_all_robots() -> None:
    """As that of SyncVectorEnv: what has not begun has no state to move from."""
    env = SnakeModeSelectionVectorEnv(2)
    with pytest.raises(InvalidInputError, match=r"reset_mask = .*all robots at the first reset"):
        env.reset(seed=0, options={"reset_mask": np.array([True, False])})
    env.reset(seed=0, options={"reset_mask": np.array([True, True])})
    env.reset(options={"reset_mask": np.array([True, False])})


@pytest.mark.parametrize("options", [[1], 5, "phi0"])
def test_options_that_are_no_dict__are_refused(options: Any) -> None:
    with pytest.raises(InvalidInputError, match=r"options = .*expected a dict"):
        SnakeModeSelectionVectorEnv(2).reset(options=options)
