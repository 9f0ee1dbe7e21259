"""One-step policies: +critic among a policy's preferred modes, and the value of every feasible mode."""

import dataclasses
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from snake_env import InvalidInputError, SnakeParams, SnakeState, UnknownNameError, load_policy
from snake_env.modes import mode_table
from snake_env.networks.model_file import Model, read_model, write_model
from snake_env.networks.network import Network
from snake_env.networks.symmetry import Images
from snake_env.policies import one_step
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.policies.one_step import MIN_PROGRESS, Choice, CriticPolicy, ValuePolicy, best_mode
from snake_env.policies.search import expand
from snake_env.policies.value import (
    ActionValue,
    NetworkValue,
    PhaseValue,
    ValueFunction,
    load_value,
)
from snake_env.sim import optimizer
from snake_env.sim.observation import observation_rows, observation_size
from snake_env.sim.simulation import advance, predict
from snake_env.sim.tasks import load_tasks
from snake_env.state import FloatArray, StateBatch
from tests.support.models import model_of
from tests.support.plus_critic import plus_critic
from tests.support.robots import DEADLOCK, FIVE, NARROW, PAPER, random_state

PRETRAINED = Path(str(files("snake_env") / "pretrained"))
ROBOTS = {
    "paper": SnakeParams(),
    "narrow": SnakeParams.preset("narrow"),
    "hardware": SnakeParams.preset("hardware"),
    "six": SnakeParams.preset("six"),
    "ten": SnakeParams.preset("ten"),
}


def _of(params: SnakeParams, kind: str, seed: int) -> Model:
    """A random network for a robot."""
    given = model_of(seed, params.n_joints, kind)
    return Model(given.kind, params, given.network)


@pytest.fixture
def lanes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many modes each call of the simulation has got."""
    seen: list[int] = []

    def counted(simulate: Callable[..., Any]) -> Callable[..., Any]:
        def counting(state: SnakeState, modes: Any, params: SnakeParams) -> Any:
            seen.append(len(modes))
            return simulate(state, modes, params)

        return counting

    for room, name in ((one_step, "ends"), (one_step, "predict"), (optimizer, "predict")):
        monkeypatch.setattr(room, name, counted(getattr(room, name)))
    return seen


def _decided(policy: CriticPolicy, state: SnakeState, lanes: list[int]) -> tuple[int, int]:
    """What the policy chooses in an episode that begins here, and the lanes that were simulated."""
    policy.reset()
    before, rollouts = sum(lanes), policy.rollouts
    mode = policy.select_mode(state)
    simulated = sum(lanes) - before
    assert policy.rollouts - rollouts == simulated
    return mode, simulated


@pytest.mark.parametrize("k", [1, 4, 8])
@pytest.mark.parametrize("robot", ROBOTS)
def test_critic__takes_what_a_transcription_takes(robot: str, k: int, lanes: list[int]) -> None:
    params = ROBOTS[robot]
    model, value = _of(params, "policy", 3), NetworkValue(_of(params, "value", 4), params)
    policy = CriticPolicy(NetworkPolicy(params, model), value, params, k)
    rules = set()
    for seed in range(25):
        state = random_state(seed, params)
        ranked = NetworkPolicy(params, model).ranking(state, unless=k)
        told = plus_critic(state, ranked, value, params, k)
        assert _decided(policy, state, lanes) == (told.mode, told.simulated)
        rules.add(told.rule)
    assert {"preferred modes", "last resort", "no choice"} <= rules


def _at_a_limit(seed: int, params: SnakeParams) -> SnakeState:
    """A state in which the joint behind the SCP can hardly turn on: some modes lead nowhere."""
    state = random_state(seed, params)
    phi, joint = state.phi.copy(), min(state.phase, params.n_joints - 1)
    phi[joint] = np.copysign(params.phi_limit - 1e-5, phi[joint])
    return state.replace(phi=phi)


def _misled(state: SnakeState, params: SnakeParams) -> Model:
    """A policy that prefers what leads nowhere, then what can't be executed, then what touches."""
    valid = mode_table(params.n_joints).valid(state.phase)
    found = predict(state, valid, params)
    executable = found.feasible & (found.d_min >= params.d_touch)
    turn = np.abs(found.phi - state.phi).max(axis=1)
    logits = np.zeros(len(mode_table(params.n_joints)), np.float32)
    logits[valid] = np.select([executable & (turn < 0.05), ~executable], [20.0, 10.0])
    logits -= 0.01 * np.arange(len(logits), dtype=np.float32)
    shape = observation_size(params.n_joints), len(logits)
    return Model("policy", params, Network([np.zeros(shape, np.float32)], [logits]))


@pytest.mark.parametrize("ranker", ["network", "phases"])
@pytest.mark.parametrize("robot", ROBOTS)
def test_critic__looks_further_where_the_preferred_modes_lead_nowhere(
    robot: str, ranker: str, lanes: list[int]
) -> None:
    params = ROBOTS[robot]
    network = NetworkValue(_of(params, "value", 4), params)
    value: ValueFunction = network if ranker == "network" else PhaseValue(params)
    rules = set()
    for seed in range(40):
        state = _at_a_limit(seed, params)
        model = _misled(state, params)
        for k in (1, 2, 8):
            ranked = NetworkPolicy(params, model).ranking(state, unless=k)
            told = plus_critic(state, ranked, value, params, k)
            given = () if k == 8 else (k,)  # 8 is the default
            policy = CriticPolicy(NetworkPolicy(params, model), value, params, *given)
            assert _decided(policy, state, lanes) == (told.mode, told.simulated)
            rules.add(told.rule)
    assert rules | {"last resort"} == {
        *("preferred modes", "next preferred modes", "others"),
        *("leads nowhere", "last resort", "no choice"),
    }


@pytest.mark.parametrize("robot", ROBOTS)
def test_critic__where_nothing_leads_anywhere_takes_from_the_first_that_can_be_executed(
    robot: str, lanes: list[int]
) -> None:
    params = ROBOTS[robot]
    several = 0
    for seed in range(300):
        state = _at_a_limit(seed, params)
        valid = mode_table(params.n_joints).valid(state.phase)
        found = predict(state, valid, params)
        can = found.feasible & (found.d_min >= params.d_touch)
        if can.sum() < 2 or np.abs(found.phi[can] - state.phi).max() >= 0.05:
            continue  # one of them leads somewhere
        model = _misled(state, params)
        ranked = NetworkPolicy(params, model).ranking(state)
        lowest = {int(mode): -float(place) for place, mode in enumerate(ranked)}

        def worst_first(states: StateBatch, worth: dict[int, float] = lowest) -> np.ndarray:
            """The later a preferred mode comes, the better is its end."""
            return np.array([worth[int(mode)] for mode in states.last_mode])

        for k in (1, 2):
            told = plus_critic(state, ranked, worst_first, params, k)
            policy = CriticPolicy(NetworkPolicy(params, model), worst_first, params, k)
            assert _decided(policy, state, lanes) == (told.mode, told.simulated)
            assert told.mode in ranked[:k]
        several += 1
    assert several >= 1


def test_best_mode__says_whether_it_leads_anywhere() -> None:
    assert MIN_PROGRESS == 0.05
    params, seen = ROBOTS["six"], set()
    for seed in range(40):
        state = _at_a_limit(seed, params)
        modes = mode_table(6).valid(state.phase)
        found = predict(state, modes, params)
        turn = np.abs(found.phi - state.phi).max(axis=1)
        can = found.feasible & (found.d_min >= params.d_touch)
        for value in (PhaseValue(params), NetworkValue(_of(params, "value", 4), params)):
            choice = best_mode(state, modes[can & (turn < 0.05)], value, params)
            assert choice is None or not choice.makes_progress
            seen.add(choice is None)
            everything = best_mode(state, modes, value, params)
            if (can & (turn >= 0.05)).any():
                assert everything is not None
                assert everything.makes_progress
                assert everything.mode in modes[can & (turn >= 0.05)]
            elif can.any():
                assert everything == choice
            else:
                assert everything is None
            one = modes[can][:1]
            if len(one):
                assert best_mode(state, one, value, params) == Choice(
                    int(one[0]), bool(turn[can][0] >= 0.05)
                )
            assert best_mode(state, modes[~can], value, params) is None
    assert seen == {True, False}


@pytest.mark.parametrize("robot", ["paper", "narrow"])
def test_critic__with_all_modes_preferred_is_the_value_policy(robot: str) -> None:
    params = ROBOTS[robot]
    value = load_value(params)
    policy = CriticPolicy(NetworkPolicy(params, _of(params, "policy", 1)), value, params, 99)
    for seed in range(20):
        state = random_state(seed, params)
        feasible = predict(state, policy._policy.ranking(state, unless=99), params).feasible
        if feasible.any():
            assert policy.select_mode(state) == ValuePolicy(params, value).select_mode(state)


def test_standing_still__the_critic_does_not_repeat_what_it_executed() -> None:
    params = ROBOTS["paper"]
    state = load_tasks("random:1:9", params).initial(0, params)
    policy = load_policy("ppo+critic")
    executed = []
    for _ in range(6):
        executed.append(policy.select_mode(state))
        state = state.replace(last_mode=executed[-1], last_turn=0.0, elapsed=state.elapsed + 3.0)
    assert len(set(executed)) == 6


@pytest.mark.parametrize("images", ["canonical", "both", "given"])
def test_model_file__holds_its_critic(images: Images, tmp_path: Path) -> None:
    params = SnakeParams(n_joints=6, l=0.1)  # a robot of one's own: nothing ships for it
    critic = _of(params, "value", 7)
    critic = Model("value", params, critic.network, images=images)
    model = Model("policy", params, _of(params, "policy", 2).network, {"by": "me"}, critic)
    path = tmp_path / "mine.safetensors"
    write_model(path, model)
    again = read_model(path)
    assert again.critic is not None
    assert again.critic.images == images
    for one, other in zip(again.critic.network.weights, critic.network.weights, strict=True):
        assert np.array_equal(one, other)
    state, value = random_state(3, params), NetworkValue(critic, params)
    ranked = NetworkPolicy(params, model).ranking(state, unless=5)
    chosen = load_policy(f"{path}+critic:k=5", params).select_mode(state)
    assert chosen == plus_critic(state, ranked, value, params, 5).mode
    with pytest.raises(InvalidInputError, match=r"^l = 0\.091: expected 0\.1, as the model was"):
        load_policy(f"{path}+critic", SnakeParams(n_joints=6))


def test_model_file__without_a_critic_ranks_by_its_own_action_values(tmp_path: Path) -> None:
    params = SnakeParams(n_joints=6, l=0.1)
    plain, path = _of(params, "policy", 2), tmp_path / "mine.safetensors"
    write_model(path, plain)
    with pytest.raises(InvalidInputError, match="holds a critic or action values"):
        load_policy(f"{path}+critic", params)  # a PPO's logits are no values
    model = dataclasses.replace(plain, action_values=True)
    write_model(path, model)
    policy = load_policy(f"{path}+critic:k=3", params)
    others = CriticPolicy(NetworkPolicy(params, model), PhaseValue(params), params, 3)
    differs = 0
    for seed in range(30):
        state = random_state(seed, params)
        ranked = NetworkPolicy(params, model).ranking(state, unless=3)
        told = plus_critic(state, ranked, ActionValue(model, params), params, 3)
        policy.reset()
        others.reset()
        assert policy.select_mode(state) == told.mode
        differs += others.select_mode(state) != told.mode
    assert differs > 3


@pytest.mark.parametrize("preset", ["paper", "narrow", "six", "hardware"])
def test_shipped_policies__use_the_value_network_of_their_robot(preset: str) -> None:
    params = SnakeParams.preset(preset)
    suffix = "" if preset == "paper" else f"-{preset}"
    given = read_model(PRETRAINED / f"value{suffix}.safetensors")
    model = read_model(PRETRAINED / f"ppo{suffix}.safetensors")
    value, policy = NetworkValue(given, params), load_policy("ppo+critic:k=4", params)
    for seed in range(20):
        state = random_state(seed, params)
        ranked = NetworkPolicy(params, model).ranking(state, unless=4)
        policy.reset()
        told = plus_critic(state, ranked, value, params, 4)
        assert policy.select_mode(state) == told.mode
    assert isinstance(policy, CriticPolicy)
    critic = policy._policy.models[0].critic
    assert critic is not None
    assert critic.sha256 == given.sha256


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("analytic+critic", InvalidInputError, "a learned policy before"),
        ("lookahead:width=2+critic", InvalidInputError, "a learned policy before"),
        ("ppo+critic:k=0", InvalidInputError, r"^k = 0: expected a positive integer"),
        ("ppo+critic:k=1.5", InvalidInputError, r"^k = 1\.5: expected a positive integer"),
        (
            "ppo+critic:q=3",
            UnknownNameError,
            r"unknown option of ppo\+critic 'q': .*known: k, tran",
        ),
        ("ppo+shield:k=3", UnknownNameError, r"unknown option of ppo\+shield 'k'"),
        ("ppo+critik", UnknownNameError, r"did you mean 'ppo\+critic'"),
    ],
)
def test_names__that_make_no_sense_are_refused(
    name: str, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        load_policy(name)


@pytest.mark.parametrize("params", [PAPER, FIVE, NARROW])
def test_value__takes_the_mode_whose_successor_is_worth_most(params: SnakeParams) -> None:
    chosen = set()
    value: ValueFunction = PhaseValue(params)
    if params.n_joints == 8:
        name = "value" if params.head_contact else "value-narrow"
        value = NetworkValue(read_model(PRETRAINED / f"{name}.safetensors"), params)
    for seed in range(16):
        state = random_state(seed, params)
        worth = {}
        for mode in mode_table(params.n_joints).valid(state.phase):
            after, prediction = advance(state, int(mode), params)
            if prediction.feasible[0]:
                worth[int(mode)] = float(value(StateBatch.stack([after]))[0])
        if not worth:
            continue
        policy = load_policy("value", params)
        mode = policy.select_mode(state)
        assert worth[mode] == pytest.approx(min(worth.values()), abs=1e-4)
        assert policy.rollouts == len(mode_table(params.n_joints).valid(state.phase))
        chosen.add(mode)
    assert len(chosen) >= 4


def test_value__takes_any_function_and_of_equals_the_first() -> None:
    state = random_state(0, PAPER, 3)
    valid = mode_table(8).valid(3)
    feasible = valid[predict(state, valid, PAPER).feasible]
    assert len(feasible) > 2
    first = ValuePolicy(PAPER, lambda states: np.ones(len(states)))
    last = ValuePolicy(PAPER, lambda states: -states.last_mode.astype(float))
    assert first.select_mode(state) == feasible[0]
    assert last.select_mode(state) == feasible[-1]


def test_value__asks_nobody_where_one_mode_is_feasible() -> None:
    def unasked(states: StateBatch) -> FloatArray:
        raise AssertionError

    policy, state = ValuePolicy(PAPER, unasked), random_state(2, PAPER, 8)
    valid = mode_table(8).valid(8)
    assert predict(state, valid, PAPER).feasible.tolist() == [True]
    assert policy.select_mode(state) == valid[0]
    assert policy.rollouts == 1


def test_value__holds_out_longest_where_nothing_is_feasible() -> None:
    modes = mode_table(8).valid(7)
    duration = predict(DEADLOCK, modes, NARROW).duration
    policy = load_policy("value", NARROW)
    assert policy.select_mode(DEADLOCK) == modes[np.argmax(duration)]


def test_value__does_not_stand_still_where_it_can_move() -> None:
    size = observation_size(8)
    names = [name for name, count in observation_rows(8) for _ in range(count)]
    first = np.zeros((size, 2), dtype=np.float32)
    first[names.index("last_turn")] = 1.0, -1.0  # by two rectifiers: the size of the SCP's turn
    network = Network(
        [first, np.ones((2, 1), np.float32)], [np.zeros(2, np.float32), np.zeros(1, np.float32)]
    )
    policy = ValuePolicy(PAPER, NetworkValue(Model("value", PAPER, network), PAPER))
    avoided = 0
    for seed in range(60):
        state = random_state(seed, PAPER, 1)
        state = state.replace(phi=np.append(state.phi[:-1], np.copysign(np.pi / 2, state.phi[-1])))
        tree = expand(StateBatch.stack([state]), PAPER)
        turn = np.abs(tree.states.phi - state.phi).max(axis=1, initial=0.0)
        if not (turn >= 0.01).any():
            continue
        assert turn[tree.mode.tolist().index(policy.select_mode(state))] >= 0.01
        avoided += int(turn[np.abs(tree.states.last_turn).argmin()] < 0.01)
    assert avoided >= 3
