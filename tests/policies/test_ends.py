"""Ends: what an agent would see there, bit for bit what the states that modes lead to look like."""

import dataclasses

import numpy as np
import pytest

from snake_env.errors import InvalidInputError, InvalidModeError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies.ends import Ends, ends
from snake_env.policies.search import expand
from snake_env.sim import lanes as lanes_module
from snake_env.sim.observation import observation_size, observe
from snake_env.sim.simulation import predict
from snake_env.state import StateBatch
from tests.support.robots import PAPER, random_state

PARAMS = (PAPER, SnakeParams.preset("narrow"), SnakeParams(n_joints=5))


@pytest.mark.parametrize("params", PARAMS, ids=("paper", "narrow", "5 joints"))
def test_ends__are_those_of_the_successors(params: SnakeParams) -> None:
    n, shifted, stayed, left_out = params.n_joints, 0, 0, 0
    for seed in range(5 * n):
        state = random_state(seed, params, 1 + seed % n)
        if seed % 2:  # close to the SCP's target, so that the phase may shift
            target = state.target.copy()
            target[state.phase - 1] = state.phi[state.phase - 1]
            state = state.replace(target=target)
        modes = mode_table(n).valid(state.phase)
        found, tree = ends(state, modes, params), expand(StateBatch.stack([state]), params)
        assert modes[found.executable].tolist() == tree.mode.tolist()
        seen, reached = found.observations[found.executable], found.reached[found.executable]
        np.testing.assert_array_equal(seen, observe(tree.states, params))
        assert reached.tolist() == (tree.states.phase > n).tolist()
        turns = np.abs(tree.states.phi - state.phi).max(axis=1, initial=0.0)
        np.testing.assert_array_equal(found.turn[found.executable], turns.astype(np.float32))
        assert not found.reached[~predict(state, modes, params).feasible].any()
        shifted += int((tree.states.phase > state.phase).sum())
        stayed += int((tree.states.phase == state.phase).sum())
        left_out += int((~found.executable).sum())
    assert min(shifted, stayed) >= 20
    assert left_out >= 3


@pytest.mark.parametrize("lanes", [2, 4, 8])
def test_ends__do_not_depend_on_the_width_of_blocks(
    lanes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = random_state(1, PAPER, 3)
    modes = mode_table(8).valid(3)
    expected = ends(state, modes, PAPER)
    monkeypatch.setattr(lanes_module, "block_width", lambda count: lanes)
    for count in (1, 3, 5, len(modes)):
        found = ends(state, modes[:count], PAPER)
        for field in dataclasses.fields(Ends):
            values = getattr(found, field.name), getattr(expected, field.name)[:count]
            np.testing.assert_array_equal(*values)


def test_ends__leave_out_modes_that_let_links_touch() -> None:
    params = SnakeParams(track=0.25)
    touching = 0
    for seed in range(20):
        state = random_state(seed, params, 1)
        modes = mode_table(8).valid(1)
        prediction = predict(state, modes, params)
        apart = prediction.d_min >= params.d_touch
        found = ends(state, modes, params)
        assert found.executable.tolist() == (prediction.feasible & apart).tolist()
        touching += int((prediction.feasible & ~apart).sum())
    assert touching >= 5


def test_ends__see_the_target_reached() -> None:
    state = random_state(2, PAPER, 8)
    target = np.append(state.target[:7], state.phi[7])
    found = ends(state.replace(target=target), mode_table(8).valid(8), PAPER)
    assert found.executable.tolist() == found.reached.tolist() == [True]


def test_ends__of_no_modes_are_none() -> None:
    found = ends(random_state(0), np.array([], dtype=np.int64), PAPER)
    assert found.executable.shape == found.reached.shape == (0,)
    assert found.observations.shape == (0, observation_size(8))


def test_ends__refuse_what_predict_refuses() -> None:
    with pytest.raises(InvalidModeError, match=r"^mode = 1: expected a mode valid in phase 8 "):
        ends(random_state(0, PAPER, 8), np.array([1]), PAPER)
    with pytest.raises(InvalidInputError, match=r"^state\.phi = nan: expected finite numbers, "):
        ends(random_state(0).replace(phi=np.full(8, np.nan)), np.array([0]), PAPER)
