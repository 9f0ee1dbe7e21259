"""Learned policies without roll-outs, and their shield."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from snake_env import InvalidInputError, SnakeParams, SnakeState, UnknownNameError, load_policy
from snake_env.networks.model_file import Model, write_model
from snake_env.networks.network import Network
from snake_env.networks.symmetry import Images
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.policies.shield import ShieldedPolicy
from snake_env.sim.masks import instant_mask
from snake_env.sim.observation import observation_and_mask
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import advance, predict
from snake_env.sim.tasks import load_tasks
from tests.support.models import model_of
from tests.support.robots import mirrored, straight_state

PARAMS = SnakeParams()
SUITE = load_tasks("random:40:9", PARAMS)


def preferring(order: list[int]) -> Model:
    """A network that prefers modes in this order, whatever it sees."""
    bias = np.zeros(99, dtype=np.float32)
    bias[order] = np.arange(len(order), 0, -1)
    return Model("policy", PARAMS, Network([np.zeros((99, 99), dtype=np.float32)], [bias]))


def wanted(model: Model, state: SnakeState) -> tuple[np.ndarray, np.ndarray]:
    """What the network says of the images that its model names; and the mask."""
    observation, mask = observation_and_mask(state, PARAMS)
    image, _ = observation_and_mask(mirrored(state), PARAMS)
    if model.images == "both":
        return model.network(observation) + model.network(image), mask
    return model.network(observation if state.target[-1] >= 0.0 else image), mask


@pytest.mark.parametrize("images", ["both", "canonical"])
@pytest.mark.parametrize("task", range(5))
def test_choice__is_the_preferred_stable_mode(task: int, images: Images) -> None:
    state = SUITE.initial(task, PARAMS)
    model = dataclasses.replace(model_of(task), images=images)
    logits, mask = wanted(model, state)
    policy = NetworkPolicy(PARAMS, model)
    mode = policy.select_mode(state)
    assert mask[mode]
    assert logits[mode] == pytest.approx(logits[mask].max(), rel=1e-4)
    assert policy.rollouts == 0


@pytest.mark.parametrize("images", ["both", "canonical"])
def test_ranking__holds_every_open_mode_once_the_best_first(images: Images) -> None:
    state, model = SUITE.initial(0, PARAMS), dataclasses.replace(model_of(), images=images)
    ranking = NetworkPolicy(PARAMS, model).ranking(state)
    logits, mask = wanted(model, state)
    np.testing.assert_array_equal(np.sort(ranking), np.flatnonzero(mask))
    assert (np.diff(logits[ranking]) <= 1e-4).all()


def test_ranking__comes_in_order_where_all_are_simulated_anyway() -> None:
    policy = NetworkPolicy(PARAMS, model_of())
    state = SUITE.initial(0, PARAMS)
    modes = np.flatnonzero(instant_mask(state, PARAMS))
    np.testing.assert_array_equal(policy.ranking(state, unless=len(modes)), modes)
    assert policy.ranking(state, unless=len(modes) - 1).tolist() != modes.tolist()


@pytest.mark.parametrize("images", ["both", "canonical"])
@pytest.mark.parametrize("task", range(10))
def test_choice__is_that_of_the_mirrored_robot(task: int, images: Images) -> None:
    state = SUITE.initial(task, PARAMS)
    model = dataclasses.replace(model_of(task), images=images)
    one, other = (NetworkPolicy(PARAMS, model).select_mode(s) for s in (state, mirrored(state)))
    assert one == other


def test_standing_still__no_choice_is_repeated_until_all_have_been_tried() -> None:
    state = SUITE.initial(0, PARAMS)
    policy = NetworkPolicy(PARAMS, model_of())
    count = int(instant_mask(state, PARAMS).sum())
    chosen = []
    for _ in range(count):
        chosen.append(policy.select_mode(state))
        assert policy.select_mode(state) == chosen[-1]  # asked again: nothing has happened since
        state = _executed(state, chosen[-1])
    assert sorted(chosen) == sorted(set(chosen))
    fresh = NetworkPolicy(PARAMS, model_of())
    assert policy.select_mode(state) == fresh.select_mode(
        state
    )  # all have been tried: all are open


@pytest.mark.parametrize("other", [3, 10, 98])
def test_standing_still__what_was_executed_counts_not_what_was_chosen(other: int) -> None:
    state = straight_state()
    preferred = [1, 2, other, 5]
    policy = NetworkPolicy(PARAMS, preferring(preferred))
    chosen = []
    for executed in (other, 2, 2):
        chosen.append(policy.select_mode(state))
        state = _executed(state, executed)
    assert chosen == [1, 1, 1]
    assert policy.ranking(_executed(state, 1))[0] == 5


def test_standing_still__the_shield_does_not_repeat_what_it_executed() -> None:
    for task in range(40):
        state = SUITE.initial(task, PARAMS)
        stable = np.flatnonzero(instant_mask(state, PARAMS))
        feasible = predict(state, stable, PARAMS).feasible
        if feasible.all() or feasible.sum() < 3:
            continue
        bad, good = stable[~feasible][:1], stable[feasible][:3]
        network = NetworkPolicy(PARAMS, preferring([*bad.tolist(), *good.tolist()]))
        policy = ShieldedPolicy(network, PARAMS)
        executed = []
        for _ in range(3):
            executed.append(policy.select_mode(state))
            state = _executed(state, executed[-1])
        assert executed == good.tolist()
        return
    pytest.fail("no task has a stable mode that turns out infeasible")


def test_first_decision__takes_no_mode_for_tried() -> None:
    states = (SUITE.initial(task, PARAMS) for task in range(len(SUITE)))
    state = next(state for state in states if instant_mask(state, PARAMS)[98])  # -1 means it too
    policy = NetworkPolicy(PARAMS, preferring([98]))
    assert [policy.select_mode(state.replace(elapsed=k)) for k in (0.0, 3.0)] == [98, 98]


def _executed(state: SnakeState, mode: int) -> SnakeState:
    """The robot after a mode that did not move it."""
    return state.replace(last_mode=mode, last_turn=0.0, elapsed=state.elapsed + 3.0)


def test_moving_on__makes_all_choices_open_again() -> None:
    state = SUITE.initial(0, PARAMS)
    policy = NetworkPolicy(PARAMS, model_of())
    first = policy.select_mode(state)
    moved = state.replace(phi=state.phi + 0.002)
    again = NetworkPolicy(PARAMS, model_of()).select_mode(moved)
    assert policy.select_mode(moved) == again == first
    policy.select_mode(moved)
    policy.reset()
    assert policy.select_mode(moved) == first


def test_model__of_other_robots_or_another_kind_is_refused() -> None:
    with pytest.raises(
        InvalidInputError, match="n_joints = 8: expected 6, as the model was trained for"
    ):
        NetworkPolicy(PARAMS, model_of(n_joints=6))
    with pytest.raises(InvalidInputError, match=r"model\.kind"):
        NetworkPolicy(PARAMS, model_of(kind="value"))


def test_shield__passes_a_feasible_preferred_mode_for_one_rollout() -> None:
    state = SUITE.initial(1, PARAMS)
    mode = AnalyticOptimizer(PARAMS).select(state).mode
    assert mode is not None
    policy = ShieldedPolicy(NetworkPolicy(PARAMS, preferring([mode])), PARAMS)
    assert policy.select_mode(state) == mode
    assert policy.rollouts == 1


def test_shield__takes_the_first_feasible_choice() -> None:
    for task in range(40):
        state = SUITE.initial(task, PARAMS)
        stable = np.flatnonzero(instant_mask(state, PARAMS))
        feasible = predict(state, stable, PARAMS).feasible
        if feasible.all():
            continue
        bad, good = stable[~feasible][:3], stable[feasible][:2]
        network = NetworkPolicy(PARAMS, preferring([*bad.tolist(), *good.tolist()]))
        policy = ShieldedPolicy(network, PARAMS)
        assert policy.select_mode(state) == good[0]
        assert 1 < policy.rollouts <= 9
        return
    pytest.fail("no task has a stable mode that turns out infeasible")


def test_shield__asks_the_optimiser_where_a_policy_has_one_choice_only() -> None:
    class Stubborn:
        rollouts = 5

        def reset(self, seed: int | None = None) -> None: ...

        def select_mode(self, state: SnakeState) -> int:
            return bad

    for task in range(40):
        state = SUITE.initial(task, PARAMS)
        selection = AnalyticOptimizer(PARAMS).select(state)
        if selection.mode is None or selection.prediction.feasible.all():
            continue
        bad = int(selection.modes[np.argmin(selection.prediction.feasible)])
        policy = ShieldedPolicy(Stubborn(), PARAMS)
        assert policy.select_mode(state) == selection.mode
        assert policy.rollouts == 5 + 1 + len(selection.modes)
        return
    pytest.fail("every mode is feasible everywhere")


def test_shield__breaks_no_constraint_unless_there_is_no_other_way() -> None:
    policy = ShieldedPolicy(NetworkPolicy(PARAMS, model_of(3)), PARAMS)
    for task in range(len(SUITE)):
        state = SUITE.initial(task, PARAMS)
        policy.reset(task)
        for _ in range(12):
            after, prediction = advance(state, policy.select_mode(state), PARAMS)
            if not prediction.feasible[0]:
                assert AnalyticOptimizer(PARAMS).select(state).mode is None
                break
            state = after
            if state.done:
                break


def test_load_policy__runs_model_files_raw_and_shielded(tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    write_model(path, model_of())
    state = SUITE.initial(0, PARAMS)
    wanted = NetworkPolicy(PARAMS, model_of()).select_mode(state)
    assert load_policy(path).select_mode(state) == wanted
    assert load_policy(str(path)).select_mode(state) == wanted
    shielded = load_policy(f"{path}+shield")
    shielded.select_mode(state)
    assert shielded.rollouts >= 1


def test_load_policy__says_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'analytic'"):
        load_policy("analytik+shield")
    with pytest.raises(InvalidInputError, match="No such file"):
        load_policy(tmp_path / "missing.safetensors")
    expected = r"n_joints = 5: expected one of \[6, 8, 10\], for which ppo ships"
    with pytest.raises(InvalidInputError, match=expected):
        load_policy("ppo", PARAMS.replace(n_joints=5))
