"""What the training loop asks of PPO and DQN, over an algorithm of Stable-Baselines3: `Learner`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from agents.mlp import DivergedError, bfloat16_matmul, load_weights, to_numpy
from snake_env.networks.model_file import Model
from snake_env.networks.network import Network
from snake_env.params import SnakeParams

_LARGEST_WEIGHT = 1e6  # of a network that has not diverged
Report = Callable[[int, dict[str, float]], None]
"""Receives the number of decisions so far and the figures of an update."""


class Learner(ABC):
    """An algorithm that learns a policy's logits.

    Beside the newest weights it keeps their exponential mean: that is what counts, as single updates
    lose tasks that others keep.

    Args:
        model: The algorithm.
        layers: The layers of its policy.
        timesteps: Decisions to learn from.
        learning_rate: The largest.
        ema_rate: Share of the newest weights in the mean after each update.

    Attributes:
        name: What the command is called.
        action_values: Whether its policy's logits are action values.
        model: The algorithm.
    """

    name: ClassVar[str]
    action_values: ClassVar[bool]

    def __init__(
        self,
        model: BaseAlgorithm,
        layers: list[nn.Linear],
        timesteps: int,
        learning_rate: float,
        ema_rate: float,
    ) -> None:
        self.model = model
        self._layers, self._timesteps, self._learning_rate = layers, timesteps, learning_rate
        mean = get_ema_multi_avg_fn(1.0 - ema_rate)  # type: ignore[no-untyped-call]
        self._mean = AveragedModel(nn.ModuleList(layers), multi_avg_fn=mean)
        model.set_logger(Logger(folder=None, output_formats=[]))

    @abstractmethod
    def begin(self, logits: Network) -> None:
        """Begins with what another learner knows."""

    @abstractmethod
    def network(self) -> Network:
        """The logits learned so far: the mean of the weights."""

    @abstractmethod
    def critic(self, params: SnakeParams) -> Model | None:
        """What it has learned about the worth of states; None: what its logits say."""

    @abstractmethod
    def _round(self, callback: BaseCallback) -> None:
        """Some decisions and the updates that follow."""

    @bfloat16_matmul()
    def learn(self, until: int, seed: int, callback: BaseCallback, report: Report) -> None:
        """Learns until it has made ``until`` decisions, or some more: whole rounds.

        All random numbers are seeded first, and the robots begin new episodes: what follows depends on
        the state of :meth:`saved` and the seed alone.

        Raises:
            DivergedError: The weights have grown beyond all bounds.
        """
        model = self.model
        set_random_seed(seed)
        model.action_space.seed(seed)
        assert model.env is not None
        model.env.seed(seed)
        model._last_obs = None  # SB3 then begins new episodes
        total = self._timesteps
        _, callback = model._setup_learn(total, callback, reset_num_timesteps=False)
        model._total_timesteps = total
        while model.num_timesteps < min(until, total):
            model._update_current_progress_remaining(model.num_timesteps, total)
            model.logger.name_to_value.clear()
            try:
                self._round(callback)
            except ValueError:  # what is no number is no distribution and no choice
                if self._is_sane():
                    raise
                raise DivergedError(self._learning_rate) from None
            figures = {
                name.partition("/")[2]: float(value)
                for name, value in model.logger.name_to_value.items()
                if name.startswith("train/")
            }
            if figures:
                self._mean.update_parameters(nn.ModuleList(self._layers))
                report(model.num_timesteps, figures)

    def saved(self) -> dict[str, Any]:
        """The state that :meth:`learn` needs to continue."""
        model = self.model
        return {
            "num_timesteps": model.num_timesteps,
            "n_updates": model._n_updates,
            "policy": model.policy.state_dict(),
            "optimizer": model.policy.optimizer.state_dict(),
            "mean": self._mean.state_dict(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Takes up what :meth:`saved` gave."""
        model = self.model
        model.policy.load_state_dict(state["policy"])
        model.policy.optimizer.load_state_dict(state["optimizer"])
        self._mean.load_state_dict(state["mean"])
        model.num_timesteps = state["num_timesteps"]
        model._n_updates = state["n_updates"]

    def _load(self, network: Network) -> None:
        """Gives the policy and the mean a network's weights."""
        for layers in (self._layers, self._mean_layers()):
            load_weights(layers, network)

    def _averaged(self) -> Network:
        return to_numpy(self._mean_layers(), self._learning_rate)

    def _mean_layers(self) -> list[nn.Linear]:
        return [layer for layer in self._mean.module.children() if isinstance(layer, nn.Linear)]

    def _is_sane(self) -> bool:
        parts = self.model.policy.parameters()
        return all(bool((part.abs() < _LARGEST_WEIGHT).all()) for part in parts)
