"""+critic: simulate the favourites, drop what can't be executed or leads nowhere, take the best."""

from pathlib import Path

import numpy as np
import pytest

from snake_env import InvalidInputError, SnakeParams, SnakeState, UnknownNameError, load_policy
from snake_env.networks.model_file import Model, read_model, write_model
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.policies.one_step import CREEPING, CriticPolicy, ValuePolicy
from snake_env.policies.value import NetworkValue, PhaseValue, ValueFunction, load_value
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import advance, predict
from snake_env.sim.tasks import load_tasks
from snake_env.state import StateBatch
from tests.support.models import model_of
from tests.support.robots import random_state

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


def _transcription(
    state: SnakeState, ranked: np.ndarray, value: ValueFunction, params: SnakeParams, k: int
) -> int:
    """Simulates one mode at a time, ranks, takes."""
    for portion in (ranked[:k], ranked[k : 2 * k]):
        rows = []
        for mode in portion.tolist():
            after, prediction = advance(state, mode, params)
            touches = prediction.d_min[0] < params.d_touch
            if not prediction.feasible[0] or touches:
                continue
            worth = float(value(StateBatch.stack([after]))[0])
            creeps = np.abs(after.phi - state.phi).max() < np.float32(CREEPING)
            rows.append((creeps, worth, mode))
        if rows:
            least = min(creeps for creeps, _, _ in rows)
            return min((w, i, m) for i, (c, w, m) in enumerate(rows) if c == least)[2]
    return AnalyticOptimizer(params).select(state).last_resort


@pytest.mark.parametrize("k", [1, 4, 8])
@pytest.mark.parametrize("robot", ROBOTS)
def test_critic__takes_what_a_transcription_takes(robot: str, k: int) -> None:
    params = ROBOTS[robot]
    model, value = _of(params, "policy", 3), NetworkValue(_of(params, "value", 4), params)
    policy = CriticPolicy(NetworkPolicy(params, model), value, params, k)
    seen = set()
    for seed in range(25):
        state = random_state(seed, params)
        policy.reset()
        before = policy.rollouts
        ranked = NetworkPolicy(params, model).ranking(state)
        chosen = policy.select_mode(state)
        assert chosen == _transcription(state, ranked, value, params, k)
        seen.add(policy.rollouts - before)
    assert min(seen) <= k


@pytest.mark.parametrize("robot", ["paper", "narrow"])
def test_critic__with_all_modes_as_favourites_is_the_value_policy(robot: str) -> None:
    params = ROBOTS[robot]
    value = load_value(params)
    policy = CriticPolicy(NetworkPolicy(params, _of(params, "policy", 1)), value, params, 99)
    for seed in range(20):
        state = random_state(seed, params)
        feasible = predict(state, policy._policy.ranking(state), params).feasible
        if feasible.any():
            assert policy.select_mode(state) == ValuePolicy(params, value).select_mode(state)


def test_critic__needs_no_network() -> None:
    params = ROBOTS["six"]
    value, model = PhaseValue(params), _of(params, "policy", 1)
    policy = CriticPolicy(NetworkPolicy(params, model), value, params)
    for seed in range(10):
        state = random_state(seed, params)
        ranked = NetworkPolicy(params, model).ranking(state)
        policy.reset()
        assert policy.select_mode(state) == _transcription(state, ranked, value, params, 8)


def test_standing_still__the_critic_does_not_repeat_what_it_executed() -> None:
    params = ROBOTS["paper"]
    state = load_tasks("random:1:9", params).initial(0, params)
    policy = load_policy("ppo+critic")
    executed = []
    for _ in range(6):
        executed.append(policy.select_mode(state))
        state = state.replace(last_mode=executed[-1], last_turn=0.0, elapsed=state.elapsed + 3.0)
    assert len(set(executed)) == 6


@pytest.mark.parametrize("kind", ["value", "quick-value"])
def test_model_file__holds_its_critic(kind: str, tmp_path: Path) -> None:
    params = SnakeParams(n_joints=6, l=0.1)  # a robot of one's own: nothing ships for it
    critic = _of(params, "value", 7)
    critic = Model(kind, params, critic.network)  # type: ignore[arg-type]
    model = Model("policy", params, _of(params, "policy", 2).network, {"by": "me"}, critic)
    path = tmp_path / "mine.safetensors"
    write_model(path, model)
    again = read_model(path)
    assert again.critic is not None
    assert again.critic.kind == kind
    for one, other in zip(again.critic.network.weights, critic.network.weights, strict=True):
        assert np.array_equal(one, other)
    state, value = random_state(3, params), NetworkValue(critic, params)
    ranked = NetworkPolicy(params, model).ranking(state)
    chosen = load_policy(f"{path}+critic:k=5", params).select_mode(state)
    assert chosen == _transcription(state, ranked, value, params, 5)
    with pytest.raises(InvalidInputError, match=r"^l = 0\.091: expected 0\.1, as the model was"):
        load_policy(f"{path}+critic", SnakeParams(n_joints=6))


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
