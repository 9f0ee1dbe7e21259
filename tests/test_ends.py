"""Ends: what an agent would see there, to the bit what the states that modes lead to look like."""

import numpy as np
import pytest

from snake_env.ends import ends
from snake_env.errors import InvalidInputError, InvalidModeError
from snake_env.modes import mode_table
from snake_env.observation import observe
from snake_env.params import SnakeParams
from snake_env.simulation import predict, successors
from snake_env.state import SnakeState, StateBatch
from tests.conftest import PAPER, random_state

PARAMS = (PAPER, SnakeParams.preset("narrow"), SnakeParams(n_joints=5))


def _successors(state: SnakeState, modes: np.ndarray, params: SnakeParams) -> StateBatch:
    begun = StateBatch.stack([state] * len(modes))
    return successors(begun, modes, predict(state, modes, params), params)


@pytest.mark.parametrize("params", PARAMS, ids=("paper", "narrow", "5 joints"))
def test_ends__are_those_of_the_successors(params: SnakeParams) -> None:
    n, shifted, stayed = params.n_joints, 0, 0
    for seed in range(5 * n):
        state = random_state(seed, params, 1 + seed % n)
        if seed % 2:  # close to the SCP's target, so that the phase may shift
            target = state.target.copy()
            target[state.phase - 1] = state.phi[state.phase - 1]
            state = state.replace(target=target)
        modes = mode_table(n).valid(state.phase)
        found, after = ends(state, modes, params), _successors(state, modes, params)
        feasible = found.prediction.feasible
        np.testing.assert_array_equal(found.prediction.phi, after.phi)
        np.testing.assert_array_equal(
            found.observations[feasible], observe(after, params)[feasible]
        )
        assert found.reached[feasible].tolist() == (after.phase > n)[feasible].tolist()
        assert not found.reached[~feasible].any()
        shifted += int((after.phase > state.phase)[feasible].sum())
        stayed += int((after.phase == state.phase)[feasible].sum())
    assert min(shifted, stayed) >= 20


def test_ends__see_the_target_reached() -> None:
    state = random_state(2, PAPER, 8)
    target = np.append(state.target[:7], state.phi[7])
    found = ends(state.replace(target=target), mode_table(8).valid(8), PAPER)
    assert found.prediction.feasible.tolist() == found.reached.tolist() == [True]


def test_ends__of_no_modes_are_none() -> None:
    found = ends(random_state(0), np.array([], dtype=np.int64), PAPER)
    assert found.reached.shape == (0,)
    assert found.observations.shape == (0, observe(StateBatch.stack([]), PAPER).shape[1])


def test_ends__refuse_what_predict_refuses() -> None:
    with pytest.raises(InvalidModeError, match=r"^mode = 1: expected a mode valid in phase 8 "):
        ends(random_state(0, PAPER, 8), [1], PAPER)
    with pytest.raises(InvalidInputError, match=r"^state\.phi = nan: expected finite numbers$"):
        ends(random_state(0).replace(phi=np.full(8, np.nan)), [0], PAPER)
