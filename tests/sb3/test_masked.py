"""Masked PPO and DQN: nothing closed is ever chosen, nor does it count."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from agents import dqn, ppo
from agents.mlp import PREFERENCE, build, linear_layers, to_numpy
from snake_env import load_policy
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import Model, write_model
from snake_env.networks.network import Network
from snake_env.networks.symmetry import CanonicalNetwork, SymmetricNetwork, joints_observed
from snake_env.params import SnakeParams
from snake_env.sb3 import MaskedDQN, SnakeVecEnv
from snake_env.sb3.symmetric import Canonical, Symmetric
from snake_env.sim.observation import observation_size

PPO_SETTINGS = ppo.Settings(hidden=(16, 8), num_envs=4, n_steps=8, batch_size=16, n_epochs=1)
DQN_SETTINGS = dqn.Settings(
    hidden=(16, 8), num_envs=4, buffer_size=400, learning_starts=40, batch_size=16
)


class _Checked(SnakeVecEnv):
    """Counts choices that the mask forbids."""

    wrong = 0
    steps = 0

    def step_async(self, actions: NDArray[Any]) -> None:
        self.wrong += int(np.sum(~self.action_masks()[np.arange(len(actions)), actions]))
        self.steps += len(actions)
        super().step_async(actions)


@pytest.fixture
def env() -> _Checked:
    return _Checked(4, mask_in_observation=True)


@pytest.fixture
def learner(env: _Checked) -> ppo.AveragedPPO:
    return ppo.build(PPO_SETTINGS, env, seed=1, device="cpu")


@pytest.fixture
def q_learner(env: _Checked) -> MaskedDQN:
    return dqn.build(DQN_SETTINGS, env, seed=1, device="cpu")


def _tensors(observation: dict[str, NDArray[Any]]) -> dict[str, torch.Tensor]:
    return {key: torch.as_tensor(value) for key, value in observation.items()}


def _network(seed: int) -> Network:
    """Random preferences, of the size of the actors and the Q-networks here."""
    rng = np.random.default_rng(seed)
    shapes = [(99, 16), (16, 8), (8, 99)]
    return Network(
        [rng.normal(size=shape).astype(np.float32) for shape in shapes],
        [rng.normal(size=shape[1]).astype(np.float32) for shape in shapes],
    )


def test_ppo__never_chooses_a_closed_mode_while_it_learns(
    env: _Checked, learner: ppo.AveragedPPO
) -> None:
    learner.learn(256)
    assert env.steps >= 256
    assert env.wrong == 0


def test_dqn__never_chooses_a_closed_mode_while_it_learns(
    env: _Checked, q_learner: MaskedDQN
) -> None:
    q_learner.learn(256)  # the first 40 at random, then by chance and greedily
    assert env.steps >= 256
    assert env.wrong == 0


@pytest.mark.parametrize("deterministic", [True, False])
def test_predict__chooses_the_only_open_mode(
    env: _Checked, learner: ppo.AveragedPPO, q_learner: MaskedDQN, deterministic: bool
) -> None:
    observation = env.reset()
    only = np.array([3, 98, 0, 41])
    observation["action_mask"] = np.eye(99, dtype=np.int8)[only]
    q_learner.exploration_rate = 0.5
    for model in (learner, q_learner):
        for _ in range(5):
            chosen, _ = model.predict(observation, deterministic=deterministic)
            np.testing.assert_array_equal(chosen, only)


def test_ppo__policy_is_the_softmax_over_open_modes(
    env: _Checked, learner: ppo.AveragedPPO
) -> None:
    observation = env.reset()
    with torch.no_grad():
        got = learner.policy.get_distribution(_tensors(observation)).distribution.probs.numpy()
    asked = SymmetricNetwork(ppo.network(learner), 8)
    logits = asked(observation["observation"]).astype(np.float64)
    wanted = np.exp(logits) * observation["action_mask"]
    wanted /= wanted.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(got, wanted, atol=1e-6)


def test_ppo__evaluates_actions_as_it_sampled_them(env: _Checked, learner: ppo.AveragedPPO) -> None:
    observation = _tensors(env.reset())
    with torch.no_grad():
        actions, values, log_prob = learner.policy(observation)
        again, same, entropy = learner.policy.evaluate_actions(observation, actions)
    torch.testing.assert_close(again, values)
    torch.testing.assert_close(same, log_prob)
    open_modes = observation["action_mask"].sum(dim=1).double()
    assert (entropy <= torch.log(open_modes) + 1e-5).all()


def test_ppo__critic_does_not_see_the_mask(env: _Checked, learner: ppo.AveragedPPO) -> None:
    observation = _tensors(env.reset())
    other = dict(observation, action_mask=torch.ones_like(observation["action_mask"]))
    with torch.no_grad():
        torch.testing.assert_close(
            learner.policy.predict_values(observation), learner.policy.predict_values(other)
        )


def test_dqn__target_is_the_value_of_the_open_mode_that_the_online_network_prefers(
    env: _Checked, q_learner: MaskedDQN
) -> None:
    observation = env.reset()
    with torch.no_grad():
        q_learner.q_net_target.q_net[-1].weight.normal_()  # not the online network's
        q_learner.q_net_target.q_net[-1].bias[:] = -50.0  # all values are far below 0
        target = q_learner.q_net_target(_tensors(observation)).numpy().max(axis=1)
    values, online = (
        SymmetricNetwork(to_numpy(linear_layers(q_net.q_net)), 8)(observation["observation"])
        for q_net in (q_learner.q_net_target, q_learner.q_net)
    )
    chosen = np.where(observation["action_mask"] > 0, online, -np.inf).argmax(axis=1)
    np.testing.assert_allclose(target, values[np.arange(len(chosen)), chosen], rtol=1e-6)
    best = np.where(observation["action_mask"] > 0, values, -np.inf).max(axis=1)
    assert (target < best - 1e-3).any()  # and not the target network's own largest


def test_dqn__target_network_has_its_own_weights_only(q_learner: MaskedDQN) -> None:
    names = [name for name, _ in q_learner.q_net_target.named_parameters()]
    assert names == [name for name, _ in q_learner.q_net.named_parameters()]


def test_dqn__explores_all_open_modes_evenly(env: _Checked, q_learner: MaskedDQN) -> None:
    observation = env.reset()
    observation["action_mask"][:] = 0
    observation["action_mask"][:, [2, 5, 7, 11]] = 1
    q_learner.exploration_rate = 1.0
    chosen = np.concatenate([q_learner.predict(observation)[0] for _ in range(500)])
    modes, counts = np.unique(chosen, return_counts=True)
    np.testing.assert_array_equal(modes, [2, 5, 7, 11])
    assert counts.min() > 400  # of 500 each; 5 standard deviations are 97


@pytest.mark.parametrize("algorithm", [ppo, dqn], ids=["ppo", "dqn"])
def test_initialise__gives_the_policy_the_weights(
    algorithm: Any, env: _Checked, learner: ppo.AveragedPPO, q_learner: MaskedDQN
) -> None:
    model = learner if algorithm is ppo else q_learner
    given = _network(seed=0)
    algorithm.initialise(model, given, algorithm.Settings())
    observation = env.reset()
    got = algorithm.network(model)(observation["observation"])
    np.testing.assert_allclose(got, given(observation["observation"]), rtol=1e-5, atol=1e-4)
    if algorithm is dqn:
        inputs = torch.as_tensor(observation["observation"])
        for q_net in (q_learner.q_net, q_learner.q_net_target):
            np.testing.assert_allclose(
                q_net.q_net(inputs).detach().numpy(), PREFERENCE * got, rtol=1e-5, atol=1e-5
            )
    asked = SymmetricNetwork(given, 8)(observation["observation"])
    preferences = np.where(observation["action_mask"] > 0, asked, -np.inf)
    chosen, _ = model.predict(observation, deterministic=True)
    np.testing.assert_array_equal(chosen, preferences.argmax(axis=1))


def test_initialise__sharpens_what_ppo_begins_with(env: _Checked, learner: ppo.AveragedPPO) -> None:
    given = ppo.network(learner)
    ppo.initialise(learner, given, ppo.Settings(init_sharpness=4.0))
    observation = env.reset()["observation"]
    sharp = ppo.network(learner)(observation)
    np.testing.assert_allclose(sharp, 4.0 * given(observation), rtol=1e-5)


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_average__is_the_running_mean_of_the_actors_weights(env: _Checked, share: float) -> None:
    settings = dataclasses.replace(PPO_SETTINGS, ema_rate=share)
    learner = ppo.build(settings, env, seed=1, device="cpu")
    _, callback = learner._setup_learn(1000)
    layer = learner.policy.action_net
    expected = None
    for _ in range(3):
        ppo.iterate(learner, callback, settings)
        newest = layer.weight.detach().numpy().T.astype(np.float64)
        expected = newest if expected is None else expected + share * (newest - expected)
    shipped = ppo.network(learner).weights[-1]
    np.testing.assert_allclose(shipped, expected, rtol=1e-6, atol=1e-7)
    assert np.array_equal(shipped, newest) == (share == 1.0)


@pytest.mark.parametrize("algorithm", [ppo, dqn], ids=["ppo", "dqn"])
def test_model_file__prefers_in_numpy_alone_what_sb3_prefers(
    algorithm: Any,
    env: _Checked,
    learner: ppo.AveragedPPO,
    q_learner: MaskedDQN,
    tmp_path: Path,
) -> None:
    model = learner if algorithm is ppo else q_learner
    given = _network(seed=4)
    algorithm.initialise(model, given, algorithm.Settings())
    file = tmp_path / "policy.safetensors"
    write_model(file, Model("policy", SnakeParams(), algorithm.network(model), {}))
    observation = env.reset()
    for _ in range(20):
        chosen, _ = model.predict(observation, deterministic=True)
        for k, mode in enumerate(chosen):
            assert load_policy(file).select_mode(env.envs.core.states[k]) == mode
        observation, _, _, _ = env.step(chosen)


@pytest.mark.parametrize("n_joints", [5, 8, 10])
def test_symmetric_and_canonical__are_what_is_asked_in_numpy(n_joints: int) -> None:
    size = observation_size(n_joints)
    module = build([size, 16, 8, 5])
    seen = np.random.default_rng(3).uniform(-1.0, 1.0, (7, size)).astype(np.float32)
    with torch.no_grad():
        got = Symmetric(module)(torch.from_numpy(seen)).numpy()
        of_one = Canonical(module)(torch.from_numpy(seen)).numpy()
    network = to_numpy(linear_layers(module))
    wanted = SymmetricNetwork(network, n_joints)(seen)
    np.testing.assert_allclose(got, wanted, rtol=1e-5, atol=1e-6)
    wanted_of_one = CanonicalNetwork(network, n_joints)(seen)
    np.testing.assert_allclose(of_one, wanted_of_one, rtol=1e-5, atol=1e-6)
    assert not np.allclose(wanted, wanted_of_one, atol=1e-3)
    assert joints_observed(size) == n_joints


def test_joints_observed__refuses_what_no_robot_sees() -> None:
    with pytest.raises(InvalidInputError, match=r"^observation_size = 98: expected one of"):
        joints_observed(98)
