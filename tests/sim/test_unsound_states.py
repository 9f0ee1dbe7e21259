"""States that no robot can have are refused by whatever looks at them, not just by what simulates."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from snake_env import InvalidInputError, SnakeParams, SnakeState, action_mask, load_policy, observe
from snake_env.sim.masks import action_mask as mask_of_level
from tests.support.robots import PAPER, random_state

SIX = SnakeParams.preset("six")
NAN = float("nan")
UNSOUND: dict[str, tuple[dict[str, Any], str]] = {
    "not finite": ({"phi": [NAN] * 8}, r"^state\.phi = nan: expected finite"),
    "an infinite place": ({"w": [0.0, np.inf, 0.0]}, r"^state\.w = inf: expected finite"),
    "phase 0": ({"phase": 0}, r"^state\.phase = \[0\]: expected 1 to 9"),
    "a phase too far": ({"phase": 10}, r"^state\.phase = \[10\]: expected 1 to 9"),
    "half a phase": ({"phase": 2.5}, r"^state\.phase = 2\.5: expected an integer"),
    "a truth value": ({"phase": True}, r"^state\.phase = True: expected an integer"),
    "no time": ({"phase_time": NAN}, r"^state\.phase_time = nan: expected finite"),
    "a mode too far": ({"last_mode": 99}, r"^state\.last_mode = \[99\]: expected mode indices"),
    "a negative mode": ({"last_mode": -2}, r"^state\.last_mode = \[-2\]: expected mode indices"),
    "one joint": ({"phi": [0.1]}, r"^state\.phi = 1: expected n_joints = 8"),
    "six joints": ({"phi": [0.1] * 6, "target": [0.0] * 6}, r"^state\.phi = 6: expected n_joints"),
}
LOOK: dict[str, Callable[[SnakeState], Any]] = {
    "observe": lambda state: observe(state, PAPER),
    "instant": lambda state: action_mask(state, PAPER),
    "structural": lambda state: mask_of_level(state, PAPER, "structural"),
    **{
        name: lambda state, name=name: load_policy(name, PAPER).select_mode(state)
        for name in ("ppo", "dqn", "random", "ppo+shield", "ppo+critic", "value", "analytic")
    },
}


@pytest.mark.parametrize("look", LOOK)
@pytest.mark.parametrize("case", UNSOUND)
def test_unsound_state__is_refused(case: str, look: str) -> None:
    changes, message = UNSOUND[case]
    if look in ("value", "analytic", "ppo+critic") and "phase" in changes:
        message = r"^state\.phase = "
    with pytest.raises(InvalidInputError, match=message):
        LOOK[look](random_state(1).replace(**changes))


@pytest.mark.parametrize("name", ["ppo", "dqn", "random", "ppo+shield", "ppo+critic", "analytic"])
def test_state_that_has_reached_its_target__has_no_mode_to_choose(name: str) -> None:
    with pytest.raises(InvalidInputError, match=r"^state\.phase = 9: expected 1 to 8"):
        load_policy(name, PAPER).select_mode(random_state(1).replace(phase=9))


def test_large_numbers_that_are_allowed__pass() -> None:
    state = random_state(1, SIX).replace(elapsed=9e5, w=np.array([9e5, -9e5, 1.0]))
    assert np.isfinite(observe(state, SIX)).all()
