"""Models of Stable-Baselines3 as model files: they choose what ``predict`` chooses."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import DQN, PPO, SAC
from torch import nn

from snake_env import SnakeParams, action_mask, load_policy, observe
from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.networks.model_file import PREFERENCE, read_model
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.policies.one_step import CriticPolicy
from snake_env.policies.value import NetworkValue
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


def _made(name: str, activation: type[nn.Module], **more: Any) -> Any:
    """A learner with weights large enough to prefer something."""
    make, policy, masked = MAKES[name]
    settings = {"n_steps": 2, "batch_size": 4} if make is PPO else {"buffer_size": 100}
    env = SnakeVecEnv(2, mask_in_observation=masked, preset="six")
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
    assert (read.network.activation, read.symmetric, read.made) == (told, masked, {"by": "hand"})
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


@pytest.mark.parametrize("name", ["masked PPO", "plain PPO"])
def test_critic__is_ppos_own_in_intervals(tmp_path: Path, name: str) -> None:
    model, masked = _made(name, nn.Tanh), MAKES[name][2]
    reward = {"time": -0.25, "success": 3.0}
    path = write_sb3_model(model, tmp_path / "a.safetensors", SIX, reward_weights=reward)
    critic = read_model(path).critic
    assert critic is not None
    batch = StateBatch.stack(STATES)
    observations = np.stack([observe(state, SIX) for state in STATES])
    seen: Any = torch.as_tensor(observations)
    if masked:
        masks = np.stack([action_mask(state, SIX) for state in STATES]).astype(np.int8)
        seen = {"observation": seen, "action_mask": torch.as_tensor(masks)}
    with torch.no_grad():
        values = model.policy.predict_values(seen)[:, 0].numpy()
    wanted = (values - reward["success"]) / reward["time"]
    np.testing.assert_allclose(NetworkValue(critic, SIX)(batch), wanted, rtol=1e-3, atol=1e-4)
    assert isinstance(load_policy(f"{path}+critic", SIX), CriticPolicy)


def test_critic__is_left_out_where_its_unit_is_not_intervals(tmp_path: Path) -> None:
    model, path = _made("plain PPO", nn.Tanh), tmp_path / "a.safetensors"
    for weights in ({"shaping": 1.0}, {"cost": -0.1}, {"violation": -1.0}, {"time": 0.0}):
        write_sb3_model(model, path, SIX, reward_weights=weights)
        assert read_model(path).critic is None
    assert read_model(write_sb3_model(_made("plain DQN", nn.ReLU), path, SIX)).critic is None


def test_action_values__are_in_the_files_unit(tmp_path: Path) -> None:
    model = _made("masked DQN", nn.ReLU)
    read = read_model(write_sb3_model(model, tmp_path / "a.safetensors", SIX))
    raw = model.q_net.q_net(torch.as_tensor(observe(STATES[0], SIX)[None]))[0].detach().numpy()
    np.testing.assert_allclose(
        PREFERENCE * read.network(observe(STATES[0], SIX)), raw, rtol=1e-3, atol=1e-5
    )


def test_other_networks__are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    with pytest.raises(InvalidInputError, match="activation_fn = 'ELU': expected ReLU or Tanh"):
        write_sb3_model(_made("plain PPO", nn.ELU), path, SIX)
    with pytest.raises(InvalidInputError, match=r"network = .*as the robot has"):
        write_sb3_model(_made("plain PPO", nn.ReLU), path)  # the robot has 8 joints
    sac = SAC("MlpPolicy", "Pendulum-v1", buffer_size=10, device="cpu")
    with pytest.raises(InvalidInputError, match="policy = 'SACPolicy': expected a policy of PPO"):
        write_sb3_model(sac, path, SIX)
    with pytest.raises(UnknownNameError, match="tme"):
        write_sb3_model(_made("plain PPO", nn.ReLU), path, SIX, reward_weights={"tme": 1.0})
    assert not path.exists()
