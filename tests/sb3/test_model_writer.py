"""Models of Stable-Baselines3 as model files: they choose what ``predict`` chooses."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import DQN, PPO, SAC
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from torch import nn

from snake_env import SnakeParams, action_mask, load_policy, observe
from snake_env.errors import InvalidInputError, SnakeEnvError
from snake_env.networks.model_file import REWARD_PER_LOGIT, read_model
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.policies.one_step import CriticPolicy
from snake_env.policies.value import ActionValue, NetworkValue
from snake_env.sb3 import (
    MaskedActorCriticPolicy,
    MaskedDQN,
    MaskedDQNPolicy,
    SnakeVecEnv,
    write_sb3_model,
)
from snake_env.state import StateBatch
from tests.support.robots import random_state

SIX = SnakeParams.preset("six")
STATES = [random_state(seed, SIX) for seed in range(30)]
MAKES: dict[str, tuple[Any, Any, bool]] = {
    "masked PPO": (PPO, MaskedActorCriticPolicy, True),
    "plain PPO": (PPO, "MlpPolicy", False),
    "masked DQN": (MaskedDQN, MaskedDQNPolicy, True),
    "plain DQN": (DQN, "MlpPolicy", False),
}


def _made(
    name: str, activation: type[nn.Module], reward: dict[str, float] | None = None, **more: Any
) -> Any:
    """A learner with weights large enough to prefer something."""
    make, policy, masked = MAKES[name]
    settings = {"n_steps": 2, "batch_size": 4} if make is PPO else {"buffer_size": 100}
    env = SnakeVecEnv(2, mask_in_observation=masked, preset="six", reward_weights=reward)
    kwargs = {"net_arch": [24, 16], "activation_fn": activation, **more}
    model = make(policy, env, seed=3, device="cpu", policy_kwargs=kwargs, **settings)
    with torch.no_grad():
        for weights in model.policy.parameters():
            weights += 0.3 * torch.randn_like(weights)
    return model


@pytest.mark.parametrize("name", MAKES)
@pytest.mark.parametrize(("activation", "told"), [(nn.ReLU, "relu"), (nn.Tanh, "tanh")])
def test_file__chooses_what_predict_chooses(
    tmp_path: Path, name: str, activation: type[nn.Module], told: str
) -> None:
    model = _made(name, activation)
    path = write_sb3_model(model, tmp_path / "a.safetensors", SIX, made={"by": "hand"})
    read, masked = read_model(path), MAKES[name][2]
    images = "both" if masked else "given"
    assert (read.network.activation, read.images, read.made) == (told, images, {"by": "hand"})
    policy, chosen = load_policy(path, SIX), set()
    assert isinstance(policy, NetworkPolicy)
    for state in STATES:
        observation, mask = observe(state, SIX), action_mask(state, SIX)
        seen = {"observation": observation, "action_mask": mask.astype(np.int8)}
        policy.reset()
        mode = policy.select_mode(state)
        if masked:
            assert mode == model.predict(seen, deterministic=True)[0]
        else:  # SB3 knows no masks: the most preferred of all is taken only where it is open
            wanted = int(model.predict(observation, deterministic=True)[0])
            assert mode == wanted or not mask[wanted]
        chosen.add(mode)
    assert len(chosen) > 2


REWARD = {"time": -0.25, "success": 3.0}


def _seen(masked: bool) -> Any:
    """What the networks are given of the states."""
    observations = torch.as_tensor(np.stack([observe(state, SIX) for state in STATES]))
    masks = np.stack([action_mask(state, SIX) for state in STATES]).astype(np.int8)
    seen = {"observation": observations, "action_mask": torch.as_tensor(masks)}
    return seen if masked else observations


@pytest.mark.parametrize("name", ["masked PPO", "plain PPO"])
def test_critic__is_ppos_own_in_intervals(tmp_path: Path, name: str) -> None:
    model, masked = _made(name, nn.Tanh, REWARD), MAKES[name][2]
    path = write_sb3_model(model, tmp_path / "a.safetensors")
    critic = read_model(path).critic
    assert critic is not None
    with torch.no_grad():
        values = model.policy.predict_values(_seen(masked))[:, 0].numpy()
    wanted = (values - REWARD["success"]) / REWARD["time"]
    told = NetworkValue(critic, SIX)(StateBatch.stack(STATES))
    np.testing.assert_allclose(told, wanted, rtol=1e-3, atol=1e-4)
    assert isinstance(load_policy(f"{path}+critic", SIX), CriticPolicy)


@pytest.mark.parametrize("name", ["masked DQN", "plain DQN"])
def test_action_values__rank_states_in_intervals(tmp_path: Path, name: str) -> None:
    model, masked = _made(name, nn.ReLU, REWARD), MAKES[name][2]
    path = write_sb3_model(model, tmp_path / "a.safetensors")
    read = read_model(path)
    assert read.action_values
    with torch.no_grad():
        values = model.q_net(_seen(masked)).numpy()
    masks = np.stack([action_mask(state, SIX) for state in STATES])
    best = np.where(masks, values, -np.inf).max(axis=1)
    wanted = (best - REWARD["success"]) / REWARD["time"]
    told = ActionValue(read, SIX)(StateBatch.stack(STATES))
    np.testing.assert_allclose(told, wanted, rtol=1e-3, atol=1e-4)
    assert isinstance(load_policy(f"{path}+critic", SIX), CriticPolicy)


@pytest.mark.parametrize("name", ["plain PPO", "plain DQN"])
@pytest.mark.parametrize(
    "weights", [{"shaping": 1.0}, {"cost": -0.1}, {"violation": -1.0}, {"time": 0.0}, {"time": 0.1}]
)
def test_critic__is_left_out_where_its_unit_is_not_intervals(
    tmp_path: Path, name: str, weights: dict[str, float]
) -> None:
    path = write_sb3_model(_made(name, nn.ReLU, weights), tmp_path / "a.safetensors")
    read = read_model(path)
    assert read.critic is None
    assert not read.action_values
    load_policy(path, SIX)
    with pytest.raises(InvalidInputError, match="a model file that holds a critic or action"):
        load_policy(f"{path}+critic", SIX)
    given = write_sb3_model(_made(name, nn.ReLU), path, reward_weights=weights)
    assert read_model(given).critic is None


def test_robot_and_reward__are_those_of_the_env(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    model = _made("plain PPO", nn.ReLU)
    assert read_model(write_sb3_model(model, path)).params == SIX
    with pytest.raises(InvalidInputError, match=r"expected the robot of the model's env"):
        write_sb3_model(model, path, SnakeParams())
    watched = PPO("MlpPolicy", VecMonitor(SnakeVecEnv(2, preset="six")), n_steps=2, batch_size=4)
    assert read_model(write_sb3_model(watched, path)).params == SIX
    model.save(tmp_path / "a.zip")
    without_env = PPO.load(tmp_path / "a.zip", device="cpu")
    with pytest.raises(InvalidInputError, match="params = None: expected the robot's constants"):
        write_sb3_model(without_env, path)
    assert read_model(write_sb3_model(without_env, path, SIX)).params == SIX
    env = gymnasium.make("SnakeModeSelectionSix-v0")
    single = PPO("MlpPolicy", env, n_steps=2, batch_size=2, device="cpu")
    assert read_model(write_sb3_model(single, path)).params == SIX


class Own(FlattenExtractor):
    """Layers of its own."""


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "path": ({"path": "a.zip"}, r"path = 'a\.zip'"),
    "params": ({"params": "six"}, "params = 'six': expected SnakeParams"),
    "made": ({"made": [1, 2]}, r"made = \[1, 2\]: expected a dict"),
    "made of what": ({"made": {"x": object()}}, "made = .*: expected a dict that JSON can hold"),
    "reward": ({"reward_weights": {"tme": 1.0}}, "tme"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_arguments__are_refused(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given, message = BAD[case]
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SnakeEnvError, match=message):
        write_sb3_model(**{"model": _made("plain PPO", nn.ReLU), "path": "a.safetensors", **given})
    assert list(tmp_path.iterdir()) == []


def test_what_stands_before_the_network__is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    with pytest.raises(InvalidInputError, match="features_extractor_class = 'Own'"):
        write_sb3_model(_made("plain PPO", nn.ReLU, features_extractor_class=Own), path)
    with pytest.raises(InvalidInputError, match="features_extractor_class = 'Own'"):
        write_sb3_model(_made("plain DQN", nn.ReLU, features_extractor_class=Own), path)
    env = VecNormalize(SnakeVecEnv(2, preset="six"))
    normalised = PPO("MlpPolicy", env, n_steps=2, batch_size=4, device="cpu")
    with pytest.raises(InvalidInputError, match="model = 'trained with VecNormalize'"):
        write_sb3_model(normalised, path)
    broken = _made("plain PPO", nn.ReLU)
    with torch.no_grad():
        broken.policy.action_net.weight.fill_(float("nan"))
    with pytest.raises(InvalidInputError, match="finite float32 numbers"):
        write_sb3_model(broken, path)
    assert not path.exists()


def test_action_values__are_in_the_files_unit(tmp_path: Path) -> None:
    model = _made("masked DQN", nn.ReLU)
    read = read_model(write_sb3_model(model, tmp_path / "a.safetensors", SIX))
    raw = model.q_net.q_net(torch.as_tensor(observe(STATES[0], SIX)[None]))[0].detach().numpy()
    np.testing.assert_allclose(
        REWARD_PER_LOGIT * read.network(observe(STATES[0], SIX)), raw, rtol=1e-3, atol=1e-5
    )


def test_other_networks__are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    with pytest.raises(InvalidInputError, match="activation_fn = 'ELU': expected ReLU or Tanh"):
        write_sb3_model(_made("plain PPO", nn.ELU), path)
    cart = PPO("MlpPolicy", "CartPole-v1", n_steps=2, batch_size=2, device="cpu")
    with pytest.raises(InvalidInputError, match=r"network = .*as the robot has"):
        write_sb3_model(cart, path, SIX)
    sac = SAC("MlpPolicy", "Pendulum-v1", buffer_size=10, device="cpu")
    with pytest.raises(InvalidInputError, match="policy = 'SACPolicy': expected a policy of PPO"):
        write_sb3_model(sac, path, SIX)
    assert not path.exists()
