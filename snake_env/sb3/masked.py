"""PPO and DQN of plain Stable-Baselines3 that never choose what the mask forbids.

They take the dict observations of ``SnakeVecEnv(mask_in_observation=True)``: the network sees
``observation``, and ``action_mask`` closes modes. In training as in the policy that is exported it is
asked about each state and its mirror image, and the mean of its answers counts; PPO's critic sees the
canonical one of both. What is learned of a state holds for its image.

``predict`` repeats a mode that did nothing, where the policies of ``snake_env.load_policy`` do not:
give the env ``no_repeat=True`` and both play alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import DQN
from stable_baselines3.common.distributions import Distribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, MlpExtractor
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from stable_baselines3.dqn.policies import DQNPolicy, QNetwork

from snake_env.errors import InvalidInputError
from snake_env.modes import mode_table
from snake_env.params import N_JOINTS_RANGE
from snake_env.sb3.images import BothImages, CanonicalImage, MeanOfBoth
from snake_env.sim.observation import observation_size

CLOSED = -1e8
"""Logit, or action value, of a mode that the mask forbids."""
_PARTS = ("observation", "action_mask")


def check_space(space: spaces.Space[Any]) -> None:
    """Checks whether observations are those of ``SnakeVecEnv(mask_in_observation=True)``.

    Raises:
        InvalidInputError: They are not, or they are stacked.
    """
    if not isinstance(space, spaces.Dict) or set(space.spaces) != set(_PARTS):
        expected = "that of SnakeVecEnv(..., mask_in_observation=True)"
        raise InvalidInputError("observation_space", space, expected)
    size, n_modes = (_size(space[part]) for part in _PARTS)
    joints = {observation_size(n): n for n in range(N_JOINTS_RANGE[0], N_JOINTS_RANGE[1] + 1)}
    if size not in joints or n_modes != len(mode_table(joints[size])):
        expected = "one observation and its mask, not stacked ones: remove VecFrameStack"
        raise InvalidInputError("observation_space", space, expected)


def checked_mask(mask: torch.Tensor) -> torch.Tensor:
    """The mask, if it is one.

    Raises:
        InvalidInputError: An entry is neither 0 nor 1.
    """
    wrong = mask[(mask != 0) & (mask != 1)]
    if len(wrong):
        expected = (
            "0 or 1: something has changed the mask. With VecNormalize, "
            'leave it out: VecNormalize(env, norm_obs_keys=["observation"])'
        )
        raise InvalidInputError("action_mask", float(wrong[0]), expected)
    return mask


class ObservationExtractor(BaseFeaturesExtractor):
    """Leaves the mask out of the features."""

    def __init__(self, observation_space: spaces.Dict) -> None:
        check_space(observation_space)
        super().__init__(observation_space, _size(observation_space["observation"]))

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """The observation proper, shape (N, observation_size)."""
        return observations["observation"]


class ObservationWithMask(BaseFeaturesExtractor):
    """The observation with the mask behind it."""

    def __init__(self, observation_space: spaces.Dict) -> None:
        check_space(observation_space)
        super().__init__(observation_space, sum(_size(observation_space[p]) for p in _PARTS))

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """The observation proper and the mask, shape (N, observation_size + n_modes)."""
        mask = checked_mask(observations["action_mask"])
        return torch.cat([observations["observation"], mask], dim=1)


class _MaskedMlp(MlpExtractor):
    """SB3's networks of actor and critic; the actor's hands the mask through, behind its latents.

    The actor's latents are means over both images: so are the linear layer's outputs that follow.
    """

    def __init__(self, n_modes: int, feature_dim: int, *args: Any, **kwargs: Any) -> None:
        super().__init__(feature_dim - n_modes, *args, **kwargs)
        self._n_modes = n_modes
        self._images, self._mean = BothImages(feature_dim - n_modes), MeanOfBoth()
        self._image = CanonicalImage(feature_dim - n_modes)

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        seen, mask = features[:, : -self._n_modes], features[:, -self._n_modes :]
        latent = self._mean(super().forward_actor(self._images(seen)))
        return torch.cat([latent, mask], dim=1)

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        seen = features[:, : -self._n_modes]
        return super().forward_critic(self._image(seen))


class MaskedActorCriticPolicy(ActorCriticPolicy):
    """Policy of PPO: masked when it samples, when it is evaluated and when it predicts.

    Args:
        *args: As those of SB3's ``ActorCriticPolicy``.
        **kwargs: As those of SB3's ``ActorCriticPolicy``, but for the features extractor.
    """

    action_space: spaces.Discrete

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs |= {"features_extractor_class": ObservationWithMask, "normalize_images": False}
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = _MaskedMlp(
            int(self.action_space.n),
            self.features_dim,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
        )

    def _get_action_dist_from_latent(self, latent_pi: torch.Tensor) -> Distribution:
        n_modes = int(self.action_space.n)
        logits = self.action_net(latent_pi[:, :-n_modes])
        closed = latent_pi[:, -n_modes:] < 0.5
        return self.action_dist.proba_distribution(action_logits=logits.masked_fill(closed, CLOSED))


class MaskedQNetwork(QNetwork):
    """Action values in which closed modes are never the largest: neither greedy nor as a target.

    Attributes:
        chooser: Of a target network: the network that chooses for it, as in double DQN (van Hasselt et
            al., AAAI 2016). SB3's target is the largest of the values, so only the chosen one is left.
    """

    chooser: tuple[MaskedQNetwork, ...] = ()  # in a tuple: its weights are not this network's

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._images, self._mean = BothImages(self.features_dim), MeanOfBoth()

    def forward(self, obs: PyTorchObs) -> torch.Tensor:
        """Action values, shape (N, n_modes)."""
        assert isinstance(obs, dict)
        seen = self._images(self.extract_features(obs, self.features_extractor))
        values: torch.Tensor = self._mean(self.q_net(seen))
        values = values.masked_fill(checked_mask(obs["action_mask"]) < 1, CLOSED)
        for network in self.chooser:
            chosen = network(obs).argmax(dim=1, keepdim=True)
            values = torch.full_like(values, CLOSED).scatter(1, chosen, values.gather(1, chosen))
        return values


class MaskedDQNPolicy(DQNPolicy):
    """Policy of :class:`MaskedDQN`.

    Args:
        *args: As those of SB3's ``DQNPolicy``.
        **kwargs: As those of SB3's ``DQNPolicy``, but for the features extractor.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs |= {"features_extractor_class": ObservationExtractor, "normalize_images": False}
        super().__init__(*args, **kwargs)

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        assert isinstance(self.q_net, MaskedQNetwork)
        assert isinstance(self.q_net_target, MaskedQNetwork)
        self.q_net_target.chooser = (self.q_net,)

    def make_q_net(self) -> MaskedQNetwork:
        """A Q-network, on the policy's device."""
        kwargs = self._update_features_extractor(self.net_args, features_extractor=None)
        return MaskedQNetwork(**kwargs).to(self.device)


class MaskedDQN(DQN):
    """DQN that explores among the modes that the mask leaves open, each robot by its own chance."""

    def predict(
        self,
        observation: NDArray[Any] | dict[str, NDArray[Any]],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Modes: greedy ones, or unless ``deterministic`` now and then random ones."""
        greedy, state = self.policy.predict(observation, state, episode_start, True)
        if deterministic:
            return greedy, state
        assert isinstance(observation, dict)
        explores = self._random().random(greedy.shape) < self.exploration_rate
        return np.where(explores, self._random_modes(observation["action_mask"]), greedy), state

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        assert isinstance(self._last_obs, dict)
        if self.num_timesteps < learning_starts:
            modes = self._random_modes(self._last_obs["action_mask"])
        else:
            modes, _ = self.predict(self._last_obs, deterministic=False)
        return modes, modes

    def _random_modes(self, mask: NDArray[Any]) -> NDArray[np.int64]:
        """One open mode for each row, uniformly."""
        checked_mask(torch.as_tensor(mask))
        chances = self._random().random(mask.shape) * (mask > 0)
        modes: NDArray[np.int64] = chances.argmax(axis=-1)
        return modes

    def _random(self) -> np.random.Generator:
        """The source of randomness that SB3 seeds."""
        return self.action_space.np_random


def _size(space: spaces.Space[Any]) -> int:
    assert space.shape is not None
    return int(np.prod(space.shape))
