"""Masked PPO and DQN: nothing closed is ever chosen, nor does it count."""

import dataclasses
import io
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CallbackList

from agents import dqn, ppo
from agents.dqn import DQNLearner
from agents.learner import Learner
from agents.mlp import build, to_numpy
from agents.ppo import SHARPNESS, PPOLearner
from snake_env import load_policy
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import REWARD_PER_LOGIT, Model, write_model
from snake_env.networks.symmetry import CanonicalNetwork, SymmetricNetwork, joints_observed, mirror
from snake_env.params import SnakeParams
from snake_env.policies.value import NetworkValue
from snake_env.sb3 import MaskedDQN, SnakeVecEnv
from snake_env.sb3.images import BothImages, CanonicalImage, MeanOfBoth
from snake_env.sb3.model_writer import linear_layers
from snake_env.sim.observation import observation_size
from tests.support.models import random_network, same_network

PPO_SETTINGS = ppo.Settings(hidden=(16, 8), num_envs=4, n_steps=8, batch_size=16, n_epochs=1)
DQN_SETTINGS = dqn.Settings(
    hidden=(16, 8), num_envs=4, buffer_size=400, learning_starts=40, batch_size=16
)
SIZES = [99, 16, 8, 99]
"""Of the actors and the Q-networks here."""


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
def ppo_learner(env: _Checked) -> PPOLearner:
    return PPOLearner(PPO_SETTINGS, env, seed=1, device="cpu")


@pytest.fixture
def learner(ppo_learner: PPOLearner) -> PPO:
    return ppo_learner.model


@pytest.fixture
def dqn_learner(env: _Checked) -> DQNLearner:
    return DQNLearner(DQN_SETTINGS, env, seed=1, device="cpu")


@pytest.fixture
def q_learner(dqn_learner: DQNLearner) -> MaskedDQN:
    return dqn_learner.model


def _tensors(observation: dict[str, NDArray[Any]]) -> dict[str, torch.Tensor]:
    return {key: torch.as_tensor(value) for key, value in observation.items()}


def test_ppo__never_chooses_a_closed_mode_while_it_learns(env: _Checked, learner: PPO) -> None:
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
    env: _Checked, learner: PPO, q_learner: MaskedDQN, deterministic: bool
) -> None:
    observation = env.reset()
    only = np.array([3, 98, 0, 41])
    observation["action_mask"] = np.eye(99, dtype=np.int8)[only]
    q_learner.exploration_rate = 0.5
    for model in (learner, q_learner):
        for _ in range(5):
            chosen, _ = model.predict(observation, deterministic=deterministic)
            np.testing.assert_array_equal(chosen, only)


def test_ppo__policy_is_the_softmax_over_open_modes(env: _Checked, ppo_learner: PPOLearner) -> None:
    observation, learner = env.reset(), ppo_learner.model
    with torch.no_grad():
        got = learner.policy.get_distribution(_tensors(observation)).distribution.probs.numpy()
    network = SymmetricNetwork(ppo_learner.network(), 8)
    logits = network(observation["observation"]).astype(np.float64)
    wanted = np.exp(logits) * observation["action_mask"]
    wanted /= wanted.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(got, wanted, atol=1e-6)


def test_ppo__evaluates_actions_as_it_sampled_them(env: _Checked, learner: PPO) -> None:
    observation = _tensors(env.reset())
    with torch.no_grad():
        actions, values, log_prob = learner.policy(observation)
        again, same, entropy = learner.policy.evaluate_actions(observation, actions)
    torch.testing.assert_close(again, values)
    torch.testing.assert_close(same, log_prob)
    open_modes = observation["action_mask"].sum(dim=1).double()
    assert (entropy <= torch.log(open_modes) + 1e-5).all()


def test_ppo__critic_does_not_see_the_mask(env: _Checked, learner: PPO) -> None:
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


@pytest.fixture(params=["ppo", "dqn"])
def either(request: pytest.FixtureRequest, ppo_learner: PPOLearner, dqn_learner: DQNLearner) -> Any:
    return {"ppo": ppo_learner, "dqn": dqn_learner}[request.param]


def test_begin__gives_the_policy_the_logits(either: Learner, env: _Checked) -> None:
    given = random_network(SIZES, 0)
    either.begin(given)
    observation = env.reset()
    sharper = SHARPNESS if isinstance(either, PPOLearner) else 1.0
    got, wanted = either.network(), given(observation["observation"])
    np.testing.assert_allclose(
        got(observation["observation"]), sharper * wanted, rtol=1e-5, atol=1e-3
    )
    if isinstance(either, DQNLearner):
        inputs = torch.as_tensor(observation["observation"])
        for q_net in (either.model.q_net, either.model.q_net_target, either.model.anchor):
            np.testing.assert_allclose(
                q_net.q_net(inputs).detach().numpy(),
                REWARD_PER_LOGIT * wanted,
                rtol=1e-5,
                atol=1e-5,
            )
    outputs = SymmetricNetwork(given, 8)(observation["observation"])
    logits = np.where(observation["action_mask"] > 0, outputs, -np.inf)
    chosen, _ = either.model.predict(observation, deterministic=True)
    np.testing.assert_array_equal(chosen, logits.argmax(axis=1))


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_network__is_the_running_mean_of_the_actors_weights(env: _Checked, share: float) -> None:
    settings = dataclasses.replace(PPO_SETTINGS, ema_rate=share)
    learner = PPOLearner(settings, env, seed=1, device="cpu")
    layer, seen = learner.model.policy.action_net, []

    def note(decisions: int, figures: dict[str, float]) -> None:
        assert {"loss", "approx_kl", "clip_fraction", "explained_variance"} <= figures.keys()
        seen.append((decisions, layer.weight.detach().numpy().T.astype(np.float64).copy()))

    learner.learn(96, 0, CallbackList([]), note)
    assert [decisions for decisions, _ in seen] == [32, 64, 96]
    expected = seen[0][1]
    for _, newest in seen[1:]:
        expected = expected + share * (newest - expected)
    shipped = learner.network().weights[-1]
    np.testing.assert_allclose(shipped, expected, rtol=1e-6, atol=1e-7)
    assert np.array_equal(shipped, seen[-1][1]) == (share == 1.0)


@pytest.mark.parametrize(("success", "time"), [(1.0, -0.1), (2.5, -0.4)])
def test_critic__says_in_intervals_what_ppos_says_in_reward(success: float, time: float) -> None:
    weights = {"success": success, "time": time}
    env = SnakeVecEnv(4, mask_in_observation=True, reward_weights=weights)
    settings = dataclasses.replace(PPO_SETTINGS, learning_rate=0.01)
    learner = PPOLearner(settings, env, seed=1, device="cpu")
    learner.learn(128, 0, CallbackList([]), lambda *_: None)
    policy, (order, sign) = learner.model.policy, mirror(8)
    observation = env.reset()
    image = {**observation, "observation": observation["observation"][:, order] * sign}
    with torch.no_grad():
        policy.value_net.bias.add_(0.4)
        reward, of_image = (
            policy.predict_values(_tensors(seen)).numpy()[:, 0] for seen in (observation, image)
        )
    critic = learner.critic(SnakeParams())
    assert (critic.kind, critic.params) == ("value", SnakeParams())
    intervals = NetworkValue(critic, SnakeParams())(env.envs.core.states)
    for wanted in (reward, of_image):
        np.testing.assert_allclose(success + time * intervals, wanted, rtol=1e-4, atol=1e-5)
    one = critic.network(observation["observation"])[:, 0]
    other = critic.network(image["observation"])[:, 0]
    assert np.abs(one - other).max() > 1e-3
    canonical = np.where(env.envs.core.states.target[:, -1] >= 0.0, one, other)
    np.testing.assert_allclose(canonical, intervals, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("ema_rate", [1.0, 0.25])
def test_restored__ppo_goes_on_as_if_nothing_had_happened(ema_rate: float) -> None:
    settings = dataclasses.replace(PPO_SETTINGS, ema_rate=ema_rate)
    through, second = (
        PPOLearner(settings, SnakeVecEnv(4, mask_in_observation=True), seed=1, device="cpu")
        for _ in range(2)
    )
    through.learn(96, 5, CallbackList([]), lambda *_: None)
    file = io.BytesIO()
    torch.save(through.saved(), file)
    file.seek(0)
    second.restore(torch.load(file, weights_only=True))
    for learner in (through, second):
        learner.learn(192, 6, CallbackList([]), lambda *_: None)
    told, again = (learner.model.policy.state_dict() for learner in (through, second))
    assert all(torch.equal(told[name], again[name]) for name in told)
    assert same_network(through.network(), second.network())
    assert through.model.num_timesteps == second.model.num_timesteps == 192


def test_critic_warmup__leaves_the_logits_alone(env: _Checked) -> None:
    settings = dataclasses.replace(PPO_SETTINGS, critic_warmup=64)
    learner = PPOLearner(settings, env, seed=1, device="cpu")
    policy = learner.model.policy
    actor, critic = policy.action_net.weight, policy.value_net.weight
    seen = [(actor.detach().clone(), critic.detach().clone())]

    def note(decisions: int, figures: dict[str, float]) -> None:
        seen.append((actor.detach().clone(), critic.detach().clone()))

    learner.learn(128, 0, CallbackList([]), note)
    pairs = list(itertools.pairwise(seen))
    assert [torch.equal(one[0], other[0]) for one, other in pairs] == [True, True, False, False]
    assert not any(torch.equal(one[1], other[1]) for one, other in pairs)


def test_model_file__prefers_in_numpy_alone_what_sb3_prefers(
    either: Learner, env: _Checked, tmp_path: Path
) -> None:
    either.begin(random_network(SIZES, 4))
    file = tmp_path / "policy.safetensors"
    write_model(file, Model("policy", SnakeParams(), either.network(), images="both"))
    observation = env.reset()
    for _ in range(20):
        chosen, _ = either.model.predict(observation, deterministic=True)
        for k, mode in enumerate(chosen):
            assert load_policy(file).select_mode(env.envs.core.states[k]) == mode
        observation, _, _, _ = env.step(chosen)


@pytest.mark.parametrize("n_joints", [5, 8, 10])
def test_images__are_what_is_seen_in_numpy(n_joints: int) -> None:
    size = observation_size(n_joints)
    module = build([size, 16, 8, 5])
    seen = np.random.default_rng(3).uniform(-1.0, 1.0, (7, size)).astype(np.float32)
    with torch.no_grad():
        of_one = module(CanonicalImage(size)(torch.from_numpy(seen))).numpy()
        of_both = MeanOfBoth()(module(BothImages(size)(torch.from_numpy(seen)))).numpy()
    network = to_numpy(linear_layers(module))
    wanted = CanonicalNetwork(network, n_joints)(seen)
    np.testing.assert_allclose(of_one, wanted, rtol=1e-5, atol=1e-6)
    wanted_of_both = SymmetricNetwork(network, n_joints)(seen)
    np.testing.assert_allclose(of_both, wanted_of_both, rtol=1e-5, atol=1e-6)
    assert not np.allclose(wanted, network(seen), atol=1e-3)
    assert not np.allclose(wanted, wanted_of_both, atol=1e-3)
    assert joints_observed(size) == n_joints


def test_joints_observed__refuses_what_no_robot_sees() -> None:
    with pytest.raises(InvalidInputError, match=r"^observation_size = 98: expected one of"):
        joints_observed(98)
