"""DQN: stable-baselines3's, masked, on many robots at once."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit
from torch import nn

from agents.checks import (
    check_at_most,
    check_hidden,
    check_not_negative,
    check_positive,
    check_share,
)
from agents.failures import failure_value
from agents.learner import Learner
from agents.mlp import linear_schedule
from snake_env.networks.model_file import REWARD_PER_LOGIT
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.sb3 import MaskedDQN, MaskedDQNPolicy, SnakeVecEnv
from snake_env.sb3.model_writer import linear_layers

_BUFFER = ("actions", "rewards", "dones", "timeouts")


class AnchoredDQN(MaskedDQN):
    """DQN whose action values stay close to those that it began with.

    A target concerns the executed mode only. Through the network it moves the values of the
    others too, mostly upwards, and what the student knew about them would be lost. So the loss holds
    the squared distance from the student's values, over all open modes. Targets are at least
    ``floor``.

    Attributes:
        anchor: The student's network; None: there is none.
        weight: Weight of the distance beside the Bellman error.
        floor: The least target: what a failure is worth, :func:`agents.failures.failure_value`.
    """

    anchor: nn.Module | None = None
    weight = 0.0
    floor = -math.inf

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """SB3's ``DQN.train`` with these two changes."""
        assert self.replay_buffer is not None
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        losses: list[float] = []
        distances: list[float] = []
        for _ in range(gradient_steps):
            batch = self.replay_buffer.sample(batch_size, env=self._vec_normalize_env)
            with torch.no_grad():
                after = self.q_net_target(batch.next_observations).max(dim=1, keepdim=True).values
                target = batch.rewards + (1.0 - batch.dones) * self.gamma * after
            values = self.q_net(batch.observations)
            chosen = values.gather(1, batch.actions.long())
            error = nn.functional.smooth_l1_loss(chosen, target.clamp(min=self.floor))
            loss = error
            if self.anchor is not None:
                with torch.no_grad():
                    known = self.anchor(batch.observations)
                assert isinstance(batch.observations, dict)
                is_open = batch.observations["action_mask"] > 0
                distance = (values - known)[is_open].square().mean()
                loss = error + self.weight * distance
                distances.append(distance.item())
            self.policy.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
            self.policy.optimizer.step()
            losses.append(error.item())
        self._n_updates += gradient_steps
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/loss", float(np.mean(losses)))
        self.logger.record("train/action_value", chosen.mean().item())
        if distances:
            self.logger.record("train/anchor_distance", float(np.mean(distances)))


@dataclass(frozen=True)
class Settings:
    """How DQN learns."""

    timesteps: int = 4_000_000
    """Decisions to learn from."""
    hidden: tuple[int, ...] = (384, 384, 192)
    """Sizes of the hidden layers."""
    num_envs: int = 256
    """Parallel environments."""
    buffer_size: int = 300_000
    """Decisions in the replay buffer."""
    learning_starts: int = 20_000
    """Decisions before the first update."""
    n_steps: int = 4
    """Steps per environment between two rounds of updates."""
    gradient_steps: int = 16
    """Gradient steps per round of updates."""
    batch_size: int = 512
    """Decisions per gradient step."""
    target_update: int = 8_192
    """Decisions between two updates of the target network."""
    learning_rate: float = 3e-4
    """Learning rate of Adam at the beginning; falls to a twentieth of it by the end."""
    gamma: float = 0.995
    """Discount factor per interval."""
    exploration: float = 0.2
    """Initial epsilon: share of random choices."""
    exploration_end: float = 0.01
    """Final epsilon, reached after half of the decisions."""
    anchor: float = 10.0
    """Weight of the penalty on leaving the action values of --init."""
    ema_rate: float = 1.0
    """EMA rate of the weights per round of updates. The average is validated and saved; 1: no
    averaging."""

    def check(self) -> None:
        """Raises InvalidInputError where a value can't be used."""
        check_hidden(self.hidden)
        check_positive(self, "timesteps", "num_envs", "n_steps", "batch_size", "learning_rate")
        check_positive(self, "buffer_size", "gradient_steps", "target_update")
        check_share(self, "exploration", "exploration_end", "gamma", "ema_rate")
        check_positive(self, "ema_rate")
        check_not_negative(self, "anchor")
        check_at_most(self, 65_536, "num_envs", "n_steps", "batch_size")
        check_at_most(self, 100_000_000, "buffer_size")
        check_not_negative(self, "learning_starts")


class DQNLearner(Learner):
    """DQN that can begin with the action values of a student, and stays close to them.

    Args:
        settings: How it learns.
        env: The robots.
        seed: Decides the weights that it begins with.
        device: Where the networks learn.
    """

    name = "dqn"
    action_values = True
    model: AnchoredDQN

    def __init__(self, settings: Settings, env: SnakeVecEnv, seed: int, device: str) -> None:
        model = AnchoredDQN(
            MaskedDQNPolicy,
            env,
            learning_rate=linear_schedule(settings.learning_rate),
            buffer_size=settings.buffer_size,
            learning_starts=settings.learning_starts,
            batch_size=settings.batch_size,
            gamma=settings.gamma,
            train_freq=settings.n_steps,
            gradient_steps=settings.gradient_steps,
            target_update_interval=settings.target_update,
            exploration_initial_eps=settings.exploration,
            exploration_final_eps=settings.exploration_end,
            exploration_fraction=0.5,
            policy_kwargs={"net_arch": list(settings.hidden), "activation_fn": nn.ReLU},
            seed=seed,
            device=device,
        )
        model.weight = settings.anchor
        options = env.envs.core.options
        model.floor = failure_value(options.params, options.weights)
        self._settings, layers = settings, linear_layers(model.q_net.q_net)
        super().__init__(
            model, layers, settings.timesteps, settings.learning_rate, settings.ema_rate
        )

    def begin(self, logits: Network) -> None:
        """Gives the action values a network's logits, and keeps them as the anchor."""
        self._load(logits.scaled(REWARD_PER_LOGIT))
        self._drop_anchor()

    def network(self) -> Network:
        """The action values as logits."""
        return self._averaged().scaled(1.0 / REWARD_PER_LOGIT)

    def critic(self, params: SnakeParams) -> None:
        """None: a state is worth its best action value."""

    def _drop_anchor(self) -> None:
        model = self.model
        model.q_net_target.load_state_dict(model.q_net.state_dict())
        if self._settings.anchor > 0.0:
            model.anchor = copy.deepcopy(model.q_net).requires_grad_(False)

    def _round(self, callback: BaseCallback) -> None:
        model, settings = self.model, self._settings
        assert model.env is not None
        assert model.replay_buffer is not None
        # SB3 sets it after each step only, so that the first one would depend on what came before.
        model.exploration_rate = model.exploration_schedule(model._current_progress_remaining)
        model.collect_rollouts(
            model.env,
            callback,
            TrainFreq(settings.n_steps, TrainFrequencyUnit.STEP),
            model.replay_buffer,
            learning_starts=0,  # SB3 would choose at random till then, whatever --init knows
        )
        if model.num_timesteps > settings.learning_starts:
            model.train(settings.gradient_steps, settings.batch_size)

    def saved(self) -> dict[str, Any]:
        """Besides, the replay buffer, a counter, and the anchor."""
        buffer, anchor = self.model.replay_buffer, self.model.anchor
        assert isinstance(buffer, DictReplayBuffer)
        rows = buffer.buffer_size if buffer.full else buffer.pos
        return {
            **super().saved(),
            "pos": buffer.pos,
            "full": buffer.full,
            "calls": self.model._n_calls,
            "anchor": None if anchor is None else anchor.state_dict(),
            **{name: torch.from_numpy(array[:rows]) for name, array in _arrays(buffer).items()},
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Takes up what :meth:`saved` gave."""
        model, buffer = self.model, self.model.replay_buffer
        assert isinstance(buffer, DictReplayBuffer)
        pos, full, calls = state["pos"], state["full"], state["calls"]
        if type(pos) is not int or type(full) is not bool or type(calls) is not int or calls < 0:
            raise TypeError("the replay buffer's counters")
        if not 0 <= pos < buffer.buffer_size:
            raise ValueError(f"position {pos} in a replay buffer of {buffer.buffer_size}")
        if state["anchor"] is not None:
            model.q_net.load_state_dict(state["anchor"])
            self._drop_anchor()
        super().restore(state)
        buffer.pos, buffer.full, model._n_calls = pos, full, calls
        rows = buffer.buffer_size if full else pos
        for name, array in _arrays(buffer).items():
            array[:rows] = state[name].numpy().reshape(rows, *array.shape[1:])


def _arrays(buffer: DictReplayBuffer) -> dict[str, Any]:
    """The arrays of a replay buffer, by name."""
    arrays = {name: getattr(buffer, name) for name in _BUFFER}
    for part in ("observations", "next_observations"):
        arrays |= {f"{part}.{key}": array for key, array in getattr(buffer, part).items()}
    return arrays
