"""PPO: stable-baselines3's, masked, on many robots at once."""

from __future__ import annotations

from dataclasses import dataclass

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from agents.checks import (
    check_at_most,
    check_hidden,
    check_not_negative,
    check_positive,
    check_share,
)
from agents.learner import Learner
from agents.mlp import linear_schedule, load_weights, to_numpy
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import Model
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.sb3 import MaskedActorCriticPolicy, SnakeVecEnv
from snake_env.sb3.model_writer import in_intervals, in_reward, linear_layers

SHARPNESS = 3.0
"""Multiplies the logits that the actor begins with. A student's own are those of a soft maximum:
drawn from them, too many modes are not the best one, and PPO would first have to learn what the student
knows already."""


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
    """Parallel environments."""
    n_steps: int = 32
    """Steps per environment between two updates."""
    batch_size: int = 2048
    """Decisions per gradient step."""
    n_epochs: int = 4
    """Passes over the decisions in an update."""
    learning_rate: float = 3e-4
    """Learning rate of Adam at the beginning; falls to a twentieth of it by the end."""
    clip_range: float = 0.2
    """PPO clip range."""
    entropy: float = 0.003
    """Entropy coefficient."""
    gamma: float = 0.995
    """Discount factor per interval."""
    gae_lambda: float = 0.95
    """Lambda of generalised advantage estimation."""
    critic_warmup: int = 0
    """Decisions at the start that train only the critic; useful with --init."""
    ema_rate: float = 1.0
    """EMA rate of the actor's weights per update. The average is validated and saved; 1: no
    averaging."""

    def check(self) -> None:
        """Raises InvalidInputError where a value can't be used."""
        check_hidden(self.hidden)
        check_hidden(self.critic_hidden)
        check_positive(self, "timesteps", "num_envs", "n_steps", "batch_size", "n_epochs")
        check_positive(self, "learning_rate", "clip_range", "ema_rate")
        check_share(self, "gae_lambda", "gamma", "ema_rate")
        check_at_most(self, 65_536, "num_envs", "n_steps")
        check_not_negative(self, "entropy", "critic_warmup")
        if self.num_envs * self.n_steps < 2:
            expected = "2 or more together with --num-envs: advantages are normalised"
            raise InvalidInputError("n_steps", self.n_steps, expected)
        if self.batch_size < 2:
            expected = "2 or more: advantages are normalised in a batch"
            raise InvalidInputError("batch_size", self.batch_size, expected)


class PPOLearner(Learner):
    """PPO whose actor and critic can begin with what others have learned.

    Args:
        settings: How it learns.
        env: The robots.
        seed: Decides the weights that it begins with.
        device: Where the networks learn.
    """

    name = "ppo"
    action_values = False
    model: PPO

    def __init__(self, settings: Settings, env: SnakeVecEnv, seed: int, device: str) -> None:
        model = PPO(
            MaskedActorCriticPolicy,
            env,
            learning_rate=linear_schedule(settings.learning_rate),
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
        policy = model.policy
        actor = linear_layers([*policy.mlp_extractor.policy_net, policy.action_net])
        super().__init__(
            model, actor, settings.timesteps, settings.learning_rate, settings.ema_rate
        )
        self._actor, self._critic_warmup = actor, settings.critic_warmup
        self._reward = env.envs.core.options.weights
        self._critic = linear_layers([*policy.mlp_extractor.value_net, policy.value_net])

    def begin(self, logits: Network) -> None:
        """Gives the actor a network's logits, sharper: see :data:`SHARPNESS`."""
        self._load(logits.scaled(SHARPNESS))

    def begin_critic(self, value: Network) -> None:
        """Gives the critic a value network's weights, from intervals into reward."""
        load_weights(self._critic, in_reward(value, self._reward))

    def network(self) -> Network:
        """The actor's network: a logit for each mode."""
        return self._averaged()

    def critic(self, params: SnakeParams) -> Model:
        """PPO's critic, from reward into intervals."""
        learned = to_numpy(self._critic, self._learning_rate)
        return Model("value", params, in_intervals(learned, self._reward))

    def _round(self, callback: BaseCallback) -> None:
        model = self.model
        assert model.env is not None
        for layer in self._actor:
            layer.requires_grad_(model.num_timesteps >= self._critic_warmup)
        model.collect_rollouts(model.env, callback, model.rollout_buffer, model.n_steps)
        model.train()
