"""Masks against the mode table, the oracle's stability and the predictions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from snake_env.errors import UnknownNameError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.masks import action_masks
from snake_env.sim.simulation import predict
from snake_env.state import SnakeState, StateBatch
from tests.support import first
from tests.support.robots import (
    KNIFE_EDGE,
    NARROW,
    PAPER,
    oracle_interval,
    random_state,
    seeds,
    stability_margin,
    straight_state,
)

LEVELS = ("structural", "instant", "lookahead")


def _mask(state: SnakeState, level: str, params: SnakeParams = PAPER) -> np.ndarray:
    return action_masks(StateBatch.stack([state]), params, level)[0]


def _without_support(params: SnakeParams) -> SnakeState:
    """A state of phase 1 in which no mode is stable at t_k."""
    modes = mode_table(8).valid(1)
    for seed in range(1000):
        state = random_state(seed, params, 1)
        if max(stability_margin(state.phi, state, m, params) for m in modes[:8]) < 0 and (
            max(stability_margin(state.phi, state, m, params) for m in modes) < -KNIFE_EDGE
        ):
            return state
    raise AssertionError("no such state found")


@given(seeds, st.sampled_from([6, 8]))
def test_structural_mask__is_the_mode_tables(seed: int, n_joints: int) -> None:
    params = SnakeParams(n_joints=n_joints)
    state = random_state(seed, params)
    mask = _mask(state, "structural", params)
    assert mask.tolist() == mode_table(n_joints).mask(state.phase).tolist()


@pytest.mark.parametrize("params", [PAPER, NARROW, SnakeParams(n_joints=9)], ids="PN9")
def test_instant_mask__is_the_oracles_stability(params: SnakeParams) -> None:
    refused = 0
    for seed in range(40):
        state = random_state(seed, params)
        valid = mode_table(params.n_joints).valid(state.phase)
        margins = np.array([stability_margin(state.phi, state, m, params) for m in valid])
        clear = abs(margins) > KNIFE_EDGE
        mask = _mask(state, "instant", params)
        if (margins > 0).any():
            assert mask[valid][clear].tolist() == (margins > 0)[clear].tolist()
            assert mask.sum() == mask[valid].sum()
            refused += int((margins < 0).sum())
    assert refused > 3


def test_instant_mask__of_a_long_robot_is_the_oracles_stability() -> None:
    params = SnakeParams(n_joints=12)
    for phase in (1, 5, 9):
        state = random_state(phase, params, phase)
        valid = mode_table(12).valid(phase)
        mask = _mask(state, "instant", params)
        for mode in np.random.default_rng(phase).choice(valid, min(40, len(valid)), replace=False):
            margin = stability_margin(state.phi, state, int(mode), params)
            if abs(margin) > KNIFE_EDGE:
                assert mask[mode] == (margin > 0)


@given(seeds)
def test_lookahead_mask__is_what_predict_calls_feasible(seed: int) -> None:
    state = random_state(seed)
    valid = mode_table(8).valid(state.phase)
    feasible = predict(state, valid, PAPER).feasible
    mask = _mask(state, "lookahead")
    expected = feasible if feasible.any() else _mask(state, "instant")[valid]
    assert mask[valid].tolist() == expected.tolist()
    assert mask.sum() == expected.sum()


def test_lookahead_mask__is_what_the_oracle_calls_feasible() -> None:
    states = (random_state(seed, PAPER, 7) for seed in range(100))
    state = first(state for state in states if _mask(state, "lookahead").sum() == 1)
    mask = _mask(state, "lookahead")
    feasible = [oracle_interval(state, mode, PAPER).feasible for mode in (0, 7)]
    assert mask[[0, 7]].tolist() == feasible


@settings(max_examples=60)
@given(seeds, st.sampled_from([PAPER, NARROW]))
def test_masks__leave_a_choice_and_only_narrow(seed: int, params: SnakeParams) -> None:
    state = random_state(seed, params)
    structural, instant, lookahead = (_mask(state, level, params) for level in LEVELS)
    assert lookahead.any()
    assert (lookahead <= instant).all()
    assert (instant <= structural).all()


def test_instant_mask__falls_back_to_the_phases_modes() -> None:
    state = _without_support(NARROW)
    structural = mode_table(8).mask(1)
    assert _mask(state, "instant", NARROW).tolist() == structural.tolist()
    assert _mask(state, "lookahead", NARROW).tolist() == structural.tolist()


def test_lookahead_mask__falls_back_to_the_instant_mask() -> None:
    valid = mode_table(8).valid(5)
    state = first(
        state
        for state in (random_state(seed, PAPER, 5) for seed in range(1000))
        if _mask(state, "instant").sum() < 8 and not predict(state, valid, PAPER).feasible.any()
    )
    assert _mask(state, "lookahead").tolist() == _mask(state, "instant").tolist()


@pytest.mark.parametrize("level", LEVELS)
def test_masks__of_a_batch_are_those_one_by_one(level: str) -> None:
    states = [random_state(seed, NARROW) for seed in range(21)]
    states[3] = _without_support(NARROW)
    states[7] = states[7].replace(phase=9)
    together = action_masks(StateBatch.stack(states), NARROW, level)
    assert together.shape == (21, 99)
    for state, mask in zip(states, together, strict=True):
        assert mask.tolist() == _mask(state, level, NARROW).tolist()
    assert action_masks(StateBatch.stack(states[:0] or states).take([]), NARROW, level).size == 0


@pytest.mark.parametrize("level", LEVELS)
def test_masks__of_a_finished_state_allow_nothing(level: str) -> None:
    assert not _mask(straight_state().replace(phase=9), level).any()


@pytest.mark.parametrize("level", LEVELS)
def test_masks__are_fresh_arrays(level: str) -> None:
    state = random_state(1, PAPER, 3)
    mask = _mask(state, level)
    expected = mask.copy()
    mask[:] = False
    assert _mask(state, level).tolist() == expected.tolist()


def test_unknown_level__gets_a_suggestion() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'lookahead'"):
        _mask(straight_state(), "look-ahead")
