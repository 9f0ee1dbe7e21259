"""PPO: stable-baselines3's, masked, on many robots at once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from agents.checks import check_at_most, check_hidden, check_positive, check_share
from agents.mlp import falling, linear_layers, load_weights, scaled, to_numpy
from snake_env.errors import InvalidInputError
from snake_env.networks.network import Network
from snake_env.sb3 import MaskedActorCriticPolicy, SnakeVecEnv


@dataclass(frozen=True)
class Settings:
    """How PPO learns."""

    timesteps: int = 8_000_000
    """Decisions to learn from."""
    hidden: tuple[int, ...] = (384, 384, 192)
    """Sizes of the actor's hidden layers."""
    critic_hidden: tuple[int, ...] = (256, 256, 128)
    """Sizes of the critic's hidden layers."""
    num_envs: int = 512
    """Robots side by side."""
    n_steps: int = 32
    """Decisions of each robot between two updates."""
    batch_size: int = 2048
    """Decisions in a gradient step."""
    n_epochs: int = 4
    """Passes over the decisions in an update."""
    learning_rate: float = 3e-4
    """Learning rate of Adam at the beginning; falls to a twentieth of it by the end."""
    clip_range: float = 0.2
    """Clipping of the policy's ratio."""
    entropy: float = 0.003
    """Weight of the entropy."""
    gamma: float = 0.995
    """Discount for an interval."""
    gae_lambda: float = 0.95
    """Decay of the generalised advantage estimate."""
    init_sharpness: float = 1.0
    """Multiplies the preferences of --init: the larger, the rarer a choice that is not the best one."""
    critic_first: int = 0
    """Decisions at the beginning from which only the critic learns: of use after --init."""
    average: float = 1.0
    """Share of the actor's newest weights, after each update, in the running mean that is validated and
    kept; 1: the newest weights alone."""

    def check(self) -> None:
        """Raises InvalidInputError where a value can't be used."""
        check_hidden(self.hidden)
        check_hidden(self.critic_hidden)
        check_positive(self, "timesteps", "num_envs", "n_steps", "batch_size", "n_epochs")
        check_positive(self, "learning_rate", "clip_range", "init_sharpness", "average")
        check_share(self, "gae_lambda", "gamma", "average")
        check_at_most(self, 65_536, "num_envs", "n_steps")
        if not 0.0 <= self.entropy < math.inf:
            raise InvalidInputError("entropy", self.entropy, "zero or a positive number")
        if self.critic_first < 0:
            raise InvalidInputError("critic_first", self.critic_first, "zero or a positive number")
        if self.num_envs * self.n_steps < 2:
            expected = "2 or more together with --num-envs: advantages are normalised"
            raise InvalidInputError("n_steps", self.n_steps, expected)
        if self.batch_size < 2:
            expected = "2 or more: advantages are normalised in a batch"
            raise InvalidInputError("batch_size", self.batch_size, expected)


class AveragedPPO(PPO):
    """PPO beside which a running mean of the actor's weights is kept.

    Attributes:
        average: The mean, over the layers of the actor.
    """

    average: AveragedModel


def build(settings: Settings, env: SnakeVecEnv, seed: int, device: str) -> AveragedPPO:
    """A PPO learner; its random numbers and the robots' come from ``seed``."""
    model = AveragedPPO(
        MaskedActorCriticPolicy,
        env,
        learning_rate=falling(settings.learning_rate),
        n_steps=settings.n_steps,
        batch_size=settings.batch_size,
        n_epochs=settings.n_epochs,
        gamma=settings.gamma,
        gae_lambda=settings.gae_lambda,
        clip_range=settings.clip_range,
        ent_coef=settings.entropy,
        policy_kwargs={
            "net_arch": {"pi": list(settings.hidden), "vf": list(settings.critic_hidden)},
            "activation_fn": nn.ReLU,
        },
        seed=seed,
        device=device,
    )
    mean = get_ema_multi_avg_fn(1.0 - settings.average)  # type: ignore[no-untyped-call]
    model.average = AveragedModel(nn.ModuleList(_actor(model)), multi_avg_fn=mean)
    return model


def initialise(model: AveragedPPO, network: Network, settings: Settings) -> None:
    """Gives the actor a network's preferences."""
    sharp = scaled(network, settings.init_sharpness)
    for layers in (_actor(model), _mean_actor(model)):
        load_weights(layers, sharp)


def initialise_critic(model: AveragedPPO, value: Network, reward: Mapping[str, float]) -> None:
    """Gives the critic a value network's weights, from intervals into reward."""
    policy = model.policy
    layers = linear_layers([*policy.mlp_extractor.value_net, policy.value_net])
    load_weights(layers, scaled(value, reward["time"]))
    with torch.no_grad():
        layers[-1].bias.add_(reward["success"])


def iterate(model: AveragedPPO, callback: BaseCallback, settings: Settings) -> None:
    """One rollout and the update that follows."""
    assert model.env is not None
    for layer in _actor(model):
        layer.requires_grad_(model.num_timesteps >= settings.critic_first)
    model.collect_rollouts(model.env, callback, model.rollout_buffer, model.n_steps)
    model.train()
    model.average.update_parameters(nn.ModuleList(_actor(model)))


def extra_state(model: AveragedPPO) -> dict[str, Any]:
    """What goes on beside the policy and its optimiser: the actor's mean."""
    return model.average.state_dict()


def set_extra_state(model: AveragedPPO, state: dict[str, Any]) -> None:
    """Restores :func:`extra_state`."""
    model.average.load_state_dict(state)


def network(model: AveragedPPO) -> Network:
    """The actor's network, averaged: a preference for each mode."""
    return to_numpy(_mean_actor(model), model.lr_schedule(1.0))


def _actor(model: AveragedPPO) -> list[nn.Linear]:
    policy = model.policy
    return linear_layers([*policy.mlp_extractor.policy_net, policy.action_net])


def _mean_actor(model: AveragedPPO) -> list[nn.Linear]:
    return linear_layers(model.average.module.children())
