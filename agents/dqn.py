"""DQN: stable-baselines3's, masked, on many robots at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit
from torch import nn

from agents.checks import check_at_most, check_hidden, check_positive, check_share
from agents.mlp import PREFERENCE, falling, linear_layers, load_weights, scaled, to_numpy
from snake_env.errors import InvalidInputError
from snake_env.networks.network import Network
from snake_env.sb3 import MaskedDQN, MaskedDQNPolicy, SnakeVecEnv

_BUFFER = ("actions", "rewards", "dones", "timeouts")


@dataclass(frozen=True)
class Settings:
    """How DQN learns."""

    timesteps: int = 4_000_000
    """Decisions to learn from."""
    hidden: tuple[int, ...] = (384, 384, 192)
    """Sizes of the hidden layers."""
    num_envs: int = 256
    """Robots side by side."""
    buffer_size: int = 300_000
    """Decisions in the replay buffer."""
    learning_starts: int = 20_000
    """Decisions before the first update."""
    n_steps: int = 4
    """Decisions of each robot between two rounds of updates."""
    gradient_steps: int = 16
    """Gradient steps in a round of updates."""
    batch_size: int = 512
    """Decisions in a gradient step."""
    target_update: int = 8_192
    """Decisions between two updates of the target network."""
    learning_rate: float = 3e-4
    """Learning rate of Adam at the beginning; falls to a twentieth of it by the end."""
    gamma: float = 0.995
    """Discount for an interval."""
    exploration: float = 0.2
    """Share of random choices at the beginning."""
    exploration_end: float = 0.01
    """Share of random choices after the first half."""

    def check(self) -> None:
        """Raises InvalidInputError where a value can't be used."""
        check_hidden(self.hidden)
        check_positive(self, "timesteps", "num_envs", "n_steps", "batch_size", "learning_rate")
        check_positive(self, "buffer_size", "gradient_steps", "target_update")
        check_share(self, "exploration", "exploration_end", "gamma")
        check_at_most(self, 65_536, "num_envs", "n_steps", "batch_size")
        check_at_most(self, 100_000_000, "buffer_size")
        if self.learning_starts < 0:
            expected = "zero or a positive number"
            raise InvalidInputError("learning_starts", self.learning_starts, expected)


def build(settings: Settings, env: SnakeVecEnv, seed: int, device: str) -> MaskedDQN:
    """A DQN learner; its random numbers and the robots' come from ``seed``."""
    return MaskedDQN(
        MaskedDQNPolicy,
        env,
        learning_rate=falling(settings.learning_rate),
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


def initialise(model: MaskedDQN, network: Network, settings: Settings) -> None:
    """Gives the action values a network's preferences."""
    for q_net in (model.q_net, model.q_net_target):
        load_weights(linear_layers(q_net.q_net), scaled(network, PREFERENCE))


def iterate(model: MaskedDQN, callback: BaseCallback, settings: Settings) -> None:
    """Some decisions and the updates that follow."""
    assert model.env is not None
    assert model.replay_buffer is not None
    model.collect_rollouts(
        model.env,
        callback,
        TrainFreq(settings.n_steps, TrainFrequencyUnit.STEP),
        model.replay_buffer,
        learning_starts=0,  # SB3 would choose at random till then, whatever --init knows
    )
    if model.num_timesteps > settings.learning_starts:
        model.train(settings.gradient_steps, settings.batch_size)


def extra_state(model: MaskedDQN) -> dict[str, Any]:
    """What goes on beside the policy and its optimiser: the replay buffer and a counter."""
    buffer = model.replay_buffer
    assert isinstance(buffer, DictReplayBuffer)
    rows = buffer.buffer_size if buffer.full else buffer.pos
    return {
        "pos": buffer.pos,
        "full": buffer.full,
        "calls": model._n_calls,
        **{name: torch.from_numpy(array[:rows]) for name, array in _arrays(buffer).items()},
    }


def _arrays(buffer: DictReplayBuffer) -> dict[str, Any]:
    """The arrays of a replay buffer, by name."""
    arrays = {name: getattr(buffer, name) for name in _BUFFER}
    for part in ("observations", "next_observations"):
        arrays |= {f"{part}.{key}": array for key, array in getattr(buffer, part).items()}
    return arrays


def set_extra_state(model: MaskedDQN, state: dict[str, Any]) -> None:
    """Restores :func:`extra_state`."""
    buffer = model.replay_buffer
    assert isinstance(buffer, DictReplayBuffer)
    pos, full, calls = state["pos"], state["full"], state["calls"]
    if type(pos) is not int or type(full) is not bool or type(calls) is not int or calls < 0:
        raise TypeError("the replay buffer's counters")
    if not 0 <= pos < buffer.buffer_size:
        raise ValueError(f"position {pos} in a replay buffer of {buffer.buffer_size}")
    buffer.pos, buffer.full, model._n_calls = pos, full, calls
    rows = buffer.buffer_size if full else pos
    for name, array in _arrays(buffer).items():
        array[:rows] = state[name].numpy().reshape(rows, *array.shape[1:])


def network(model: MaskedDQN) -> Network:
    """The action values as preferences."""
    return scaled(
        to_numpy(linear_layers(model.q_net.q_net), model.lr_schedule(1.0)), 1.0 / PREFERENCE
    )
