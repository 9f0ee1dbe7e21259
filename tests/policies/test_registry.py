"""Policies: what each chooses, what it costs in roll-outs, and what it does where nothing works."""

import functools
import importlib.resources
import json
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies.registry import load_policy
from snake_env.sim.masks import action_masks, instant_mask
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
)

NAMES = ("analytic", "analytic-14", "first-feasible", "random")
VALID = (99, 57, 31, 16, 8, 4, 2, 1)  # modes that each phase allows


@functools.cache
def _candidates() -> dict[int, list[int]]:
    text = (importlib.resources.files("snake_env") / "policies" / "analytic_14.json").read_text()
    return {int(phase): modes for phase, modes in json.loads(text)["modes"].items()}


def _hopeless(phase: int) -> SnakeState:
    """A state of the phase in which no mode is feasible, but some hold out longer than others."""
    modes = mode_table(8).valid(phase)
    for seed in range(2000):
        state = random_state(seed, PAPER, phase)
        prediction = predict(state, modes, PAPER)
        if not prediction.feasible.any() and np.argmax(prediction.duration) > 0:
            return state
    raise AssertionError("no such state found")


@pytest.mark.parametrize("name", NAMES)
def test_load_policy__makes_every_policy_of_the_paper_preset_by_default(name: str) -> None:
    policy = load_policy(name)
    assert policy.rollouts == 0
    state = random_state(5)
    explicit = load_policy(name, PAPER)
    policy.reset(3)
    explicit.reset(3)
    assert policy.select_mode(state) == explicit.select_mode(state)


def test_load_policy__suggests_a_name() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'analytic-14'") as caught:
        load_policy("analytic14")
    assert set(NAMES) <= set(caught.value.known)


@settings(max_examples=60)
@given(st.sampled_from(NAMES), seeds, st.sampled_from([PAPER, NARROW]))
def test_policy__chooses_what_the_phase_allows_and_leaves_the_state_alone(
    name: str, seed: int, params: SnakeParams
) -> None:
    state = random_state(seed, params)
    before = repr(state)
    policy = load_policy(name, params)
    policy.reset(seed)
    mode = policy.select_mode(state)
    assert type(mode) is int
    assert mode_table(8).mask(state.phase)[mode]
    assert repr(state) == before


@pytest.mark.parametrize("name", ["analytic", "first-feasible", "random"])
@pytest.mark.parametrize("n_joints", [5, 10])
def test_policy__works_for_other_lengths(name: str, n_joints: int) -> None:
    params = SnakeParams(n_joints=n_joints)
    for phase in range(1, n_joints + 1):
        state = random_state(phase, params, phase)
        mode = load_policy(name, params).select_mode(state)
        assert mode_table(n_joints).mask(phase)[mode]


def test_analytic__costs_one_rollout_for_each_valid_mode() -> None:
    policy = load_policy("analytic")
    for phase, valid in enumerate(VALID, start=1):
        before = policy.rollouts
        policy.select_mode(random_state(phase, PAPER, phase))
        assert policy.rollouts - before == valid
    assert policy.rollouts == sum(VALID)
    policy.reset(0)
    assert policy.rollouts == sum(VALID)  # counted over all episodes


def test_analytic__takes_the_oracles_cheapest_mode() -> None:
    state = random_state(0, PAPER, 6)
    j = [oracle_interval(state, mode, PAPER).j for mode in mode_table(8).valid(6)]
    best, second = sorted(j)[:2]
    assert best < 0.999 * second
    assert load_policy("analytic").select_mode(state) == mode_table(8).valid(6)[np.argmin(j)]


@pytest.mark.parametrize("name", ["analytic", "analytic-14"])
@pytest.mark.parametrize("phase", [3, 5, 6])
def test_analytic__holds_out_longest_where_nothing_is_feasible(name: str, phase: int) -> None:
    state = _hopeless(phase)
    allowed = mode_table(8).valid(phase).tolist()
    modes = allowed if name == "analytic" else _candidates()[phase]
    lasting = {mode: float(predict(state, [mode], PAPER).duration[0]) for mode in modes}
    chosen = load_policy(name).select_mode(state)
    assert chosen in allowed
    assert lasting[chosen] == max(lasting.values())
    assert chosen == min(mode for mode in modes if lasting[mode] == lasting[chosen])
    assert load_policy("first-feasible").select_mode(state) == 0


def test_analytic_14__predicts_only_its_candidates() -> None:
    candidates = _candidates()
    for phase, valid in enumerate(VALID, start=1):
        assert len(candidates[phase]) == len(set(candidates[phase])) == min(14, valid)
        assert mode_table(8).mask(phase)[candidates[phase]].all()
        for seed in range(5):
            policy = load_policy("analytic-14")
            state = random_state(seed, PAPER, phase)
            chosen = policy.select_mode(state)
            assert policy.rollouts == len(candidates[phase])
            prediction = predict(state, candidates[phase], PAPER)
            if prediction.feasible.any():
                assert chosen == candidates[phase][int(np.argmin(prediction.j))]


def test_analytic_14__exists_for_8_joints_only() -> None:
    with pytest.raises(InvalidInputError, match=r"n_joints = 6: expected 8"):
        load_policy("analytic-14", SnakeParams(n_joints=6))


def test_first_feasible__is_the_first_and_predicts_no_more_blocks_than_it_must() -> None:
    for phase, valid in enumerate(VALID[4:], start=5):  # one block, not always a full one
        policy = load_policy("first-feasible")
        policy.select_mode(random_state(0, PAPER, phase))
        assert policy.rollouts == valid
    places = set()
    for seed in range(2000):
        state = random_state(seed, PAPER, 1 + seed % 3, head_error=0.5)
        modes = mode_table(8).valid(state.phase)
        feasible = predict(state, modes, PAPER).feasible
        if feasible.any():
            place = feasible.tolist().index(True)
            policy = load_policy("first-feasible")
            assert policy.select_mode(state) == modes[place]
            assert policy.rollouts == min(8 * (place // 8 + 1), len(modes))
            places.add(place)
        if len(places) > 2 and max(places) >= 8:  # one beyond the first block
            return
    raise AssertionError(f"only {places} seen")


def test_random__is_uniform_over_the_instant_mask_and_predicts_nothing() -> None:
    state = first(
        state
        for state in (random_state(seed, PAPER, 5) for seed in range(500))
        if 3 <= instant_mask(state, PAPER).sum() < VALID[4]
        and all(abs(stability_margin(state.phi, state, m, PAPER)) > KNIFE_EDGE for m in range(8))
    )
    mask = action_masks(StateBatch.stack([state]), PAPER, "instant")[0]
    policy = load_policy("random")
    policy.reset(0)
    counts = Counter(policy.select_mode(state) for _ in range(3000))
    assert set(counts) == set(np.flatnonzero(mask).tolist())
    share = 3000 / mask.sum()
    assert all(abs(count - share) < 5 * share**0.5 for count in counts.values())
    assert policy.rollouts == 0


def test_random__is_reproducible_by_seed() -> None:
    states = [random_state(seed, PAPER, 1) for seed in range(8)]

    def draw(seed: int | None) -> list[int]:
        policy.reset(seed)
        return [policy.select_mode(state) for state in states]

    policy = load_policy("random")
    first, other = draw(7), draw(8)
    assert draw(7) == first != other
    policy = load_policy("random")
    assert draw(7) == first
    assert draw(None) == draw(None)


@pytest.mark.parametrize("name", ["ppo+critic:k=1,k=4", "ppo:transfer=1+critic:transfer=0"])
def test_option_that_is_given_twice__is_refused(name: str) -> None:
    with pytest.raises(InvalidInputError, match="each option only once"):
        load_policy(name)
