"""Numbers so large or small that arithmetic breaks down are refused at the boundary."""

import re
from typing import Any

import numpy as np
import pytest

from snake_env import InvalidInputError, SnakeParams, SnakeState, predict
from snake_env.envs import SnakeModeSelectionEnv
from snake_env.sim.simulation import advance, joint_input
from snake_env.sim.slip import check_slip
from tests.support.robots import PAPER, straight_state

HUGE = [1e300, -1e300, 1e7, 10**400, float("inf"), float("nan")]
FIELDS = sorted(
    name for name, value in vars(PAPER).items() if isinstance(value, float) and name != "dt"
)
ARRAYS = ("phi", "target", "w")


@pytest.mark.parametrize("value", HUGE)
@pytest.mark.parametrize("field", [*FIELDS, "dt", "n_joints", "horizon"])
def test_constant__out_of_all_proportion_is_refused(field: str, value: Any) -> None:
    with pytest.raises(InvalidInputError, match=rf"^{field} = "):
        SnakeParams(**{field: value})


@pytest.mark.parametrize("field", ["l", "track", "d_0", "c_phi", "k_0", "u_limit", "cam_time"])
def test_constant__that_vanishes_is_refused(field: str) -> None:
    for value in (1e-300, 5e-324, 0.0, -0.0):
        with pytest.raises(InvalidInputError, match=rf"^{field} = .*at least 1e-09"):
            SnakeParams(**{field: value})


def test_delta_t__of_1e300_is_refused_with_any_dt() -> None:
    for dt in (0.02, 1e298, 1e300):
        with pytest.raises(InvalidInputError, match=r"^delta_t = 1e\+300"):
            SnakeParams(delta_t=1e300, dt=dt)


@pytest.mark.parametrize("field", ["gains", "w_d"])
def test_tuple__with_a_huge_number_is_refused(field: str) -> None:
    good = getattr(PAPER, field)
    for position in range(len(good)):
        bad = [*good[:position], 1e200, *good[position + 1 :]]
        with pytest.raises(InvalidInputError, match=rf"^{field} = "):
            SnakeParams(**{field: bad})


@pytest.mark.parametrize("term", ["time", "success", "failure", "violation", "cost", "shaping"])
def test_reward_weight__of_1e308_is_refused(term: str) -> None:
    for value in (1e308, -1e308, 1e7):
        with pytest.raises(InvalidInputError, match=rf"^reward_weights\['{term}'\] = "):
            SnakeModeSelectionEnv(reward_weights={term: value})


@pytest.mark.parametrize("gamma", [-0.1, 1.5, 1e308])
def test_gamma__is_a_discount(gamma: float) -> None:
    with pytest.raises(InvalidInputError, match=r"^reward_weights\['gamma'\] = "):
        SnakeModeSelectionEnv(reward_weights={"gamma": gamma})


@pytest.mark.parametrize("slip", [(1e300, 0.0), (0.0, 1e300), (-1.0, 0.0), (11.0, 0.0)])
def test_slip__out_of_all_proportion_is_refused(slip: Any) -> None:
    with pytest.raises(InvalidInputError, match=r"^slip = .*from 0 to 10"):
        check_slip(slip)


@pytest.mark.parametrize("value", [1e300, -1e7, np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("field", [*ARRAYS, "phase_time", "ref_start", "elapsed", "last_turn"])
def test_state__out_of_all_proportion_is_refused(field: str, value: float) -> None:
    state: SnakeState = straight_state()
    given: Any = value
    if field in ARRAYS:
        given = np.array(getattr(state, field))
        given[-1] = value
    bad, shown = state.replace(**{field: given}), re.escape(repr(value))
    for run in (
        lambda: predict(bad, [0], PAPER),
        lambda: advance(bad, 0, PAPER),
        lambda: joint_input(bad, 0, 0.0, PAPER),
    ):
        with pytest.raises(InvalidInputError, match=rf"^state\.{field} = {shown}: .*finite"):
            run()
