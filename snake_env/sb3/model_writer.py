"""From a model of Stable-Baselines3 or sb3-contrib to a model file, which needs neither to play."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.dqn.policies import DQNPolicy
from torch import nn

from snake_env.envs.core import checked_weights
from snake_env.envs.reward import RewardWeights
from snake_env.errors import InvalidInputError
from snake_env.modes import mode_table
from snake_env.networks.model_file import REWARD_PER_LOGIT, Model, write_model
from snake_env.networks.network import Activation, Network
from snake_env.networks.symmetry import Images
from snake_env.params import SnakeParams
from snake_env.sb3.masked import (
    MaskedActorCriticPolicy,
    MaskedQNetwork,
    ObservationExtractor,
    ObservationWithMask,
)
from snake_env.sb3.trained_for import options_of
from snake_env.sim.observation import observation_size

_ACTIVATIONS: dict[type[nn.Module], Activation] = {nn.ReLU: "relu", nn.Tanh: "tanh"}


def write_sb3_model(
    model: BaseAlgorithm,
    path: Path | str,
    params: SnakeParams | None = None,
    *,
    reward_weights: Mapping[str, float] | None = None,
    made: Mapping[str, Any] | None = None,
) -> Path:
    """Writes a model as a file that ``load_policy`` and ``python -m evaluate`` take.

    That policy chooses what ``model.predict(..., deterministic=True)`` chooses, where the mask leaves
    that open, and no mode twice where the robot has not moved (the no-repeat rule). What PPO's critic
    or DQN have learned about states serves ``+critic``.

    Args:
        model: PPO, MaskablePPO or A2C with a policy of the kind ``MlpPolicy`` or
            :class:`MaskedActorCriticPolicy`, or DQN with ``MlpPolicy`` or :class:`MaskedDQNPolicy`;
            its hidden layers have ReLU or Tanh. It sees observations as they are.
        path: Where to, ``.safetensors``.
        params: The robot that it was trained with; default: that of the model's env. After
            ``load(..., env=...)`` this is the env that was given there.
        reward_weights: What that env was given; default: what it has. Networks count in reward: with
            terms for shaping, cost or violations the file can't be used with ``+critic``.
        made: What the file says about how it was made.

    Returns:
        The file's path.

    Raises:
        InvalidInputError: A network of another kind or for another robot, a wrapper that may change
            observations, actions or rewards, or a value that can't be used.
        UnknownNameError: No such term of the reward.
    """
    file = Path(path)
    if file.suffix != ".safetensors":
        raise InvalidInputError("path", str(file), "a file whose name ends in .safetensors")
    if model.get_vec_normalize_env() is not None:
        raise InvalidInputError("model", "trained with VecNormalize", "observations as they are")
    robot, weights = _trained_for(model, params, reward_weights)
    manifest = _checked_made(made)
    policy: Any = model.policy
    is_actor = hasattr(policy, "mlp_extractor")  # sb3-contrib's are no ActorCriticPolicy
    if not (is_actor or isinstance(policy, DQNPolicy)):
        expected = "a policy of PPO, MaskablePPO, A2C or DQN"
        raise InvalidInputError("policy", type(policy).__name__, expected)
    _check_input(model)
    ranks = weights.time < 0.0 and not (weights.shaping or weights.cost or weights.violation)
    critic, values = None, False
    if is_actor:
        ours = isinstance(policy, MaskedActorCriticPolicy)
        extractor = policy.mlp_extractor
        network = _network([*extractor.policy_net, policy.action_net])
        if ranks:
            worth = _network([*extractor.value_net, policy.value_net])
            seen: Images = "canonical" if ours else "given"
            critic = Model("value", robot, in_intervals(worth, weights), images=seen)
    else:
        ours, values = isinstance(policy.q_net, MaskedQNetwork), ranks
        network = _network(list(policy.q_net.q_net))
        if ranks:  # in the units of the default reward, as files have them
            network = in_reward(in_intervals(network, weights), RewardWeights())
        network = network.scaled(1.0 / REWARD_PER_LOGIT)
    wanted = observation_size(robot.n_joints), len(mode_table(robot.n_joints))
    if (network.sizes[0], network.sizes[-1]) != wanted:
        expected = f"from {wanted[0]} observed values to {wanted[1]} modes, as the robot has"
        raise InvalidInputError("network", network.sizes, expected)
    images: Images = "both" if ours else "given"
    write_model(file, Model("policy", robot, network, manifest, critic, images, values))
    return file


def _trained_for(
    model: BaseAlgorithm, params: SnakeParams | None, reward_weights: Mapping[str, float] | None
) -> tuple[SnakeParams, RewardWeights]:
    """The robot and the reward: those of the model's env, which must not contradict what is given."""
    if not isinstance(params, SnakeParams | None):
        raise InvalidInputError("params", params, "SnakeParams")
    options = options_of(model.get_env())
    if options is None:
        if params is None:
            raise InvalidInputError(
                "params", None, "the robot's constants, as the model has no env"
            )
        return params, checked_weights(reward_weights or {})
    different = {} if params is None else options.params.differences(params)
    if different:
        expected = f"the robot of the model's env, which differs in {', '.join(different)}"
        raise InvalidInputError("params", params, expected)
    weights = checked_weights(reward_weights) if reward_weights is not None else options.weights
    return options.params, weights


def _checked_made(made: Mapping[str, Any] | None) -> dict[str, Any]:
    try:
        manifest = {} if made is None else json.loads(json.dumps(made))
    except (TypeError, ValueError):
        manifest = None
    if not isinstance(manifest, dict):
        raise InvalidInputError("made", made, "a dict that JSON can hold")
    return manifest


def _check_input(model: BaseAlgorithm) -> None:
    """Raises InvalidInputError unless the networks see observations as they are."""
    policy: Any = model.policy
    extractor = getattr(policy, "q_net", policy).features_extractor
    if type(extractor) not in (FlattenExtractor, ObservationExtractor, ObservationWithMask):
        expected = "FlattenExtractor, or that of a policy of snake_env.sb3"
        raise InvalidInputError("features_extractor_class", type(extractor).__name__, expected)


def _shifted(network: Network, offset: float) -> Network:
    """The network whose outputs are larger by so much."""
    *biases, last = network.biases
    return dataclasses.replace(network, biases=[*biases, last + np.float32(offset)])


def in_intervals(network: Network, weights: RewardWeights) -> Network:
    """A critic's network, from reward into the intervals that a state still needs."""
    return _shifted(network.scaled(1.0 / weights.time), -weights.success / weights.time)


def in_reward(network: Network, weights: RewardWeights) -> Network:
    """The inverse of :func:`in_intervals`."""
    return _shifted(network.scaled(weights.time), weights.success)


def linear_layers(modules: Iterable[nn.Module]) -> list[nn.Linear]:
    """The linear layers among some modules, in their order."""
    return [module for module in modules if isinstance(module, nn.Linear)]


def _network(modules: Sequence[nn.Module]) -> Network:
    """Linear layers with an activation function between them, as a network."""
    kinds = {type(module) for module in modules if not isinstance(module, nn.Linear)}
    if len(kinds) > 1 or not kinds <= _ACTIVATIONS.keys():
        found = ", ".join(sorted(kind.__name__ for kind in kinds))
        raise InvalidInputError("activation_fn", found, "ReLU or Tanh")
    return network_of(linear_layers(modules), *(_ACTIVATIONS[kind] for kind in kinds))


def network_of(layers: Sequence[nn.Linear], activation: Activation = "relu") -> Network:
    """Linear layers as a network, copied."""
    return Network(
        weights=[
            np.ascontiguousarray(layer.weight.detach().cpu().numpy().T, dtype=np.float32)
            for layer in layers
        ],
        biases=[layer.bias.detach().cpu().numpy().astype(np.float32).copy() for layer in layers],
        activation=activation,
    )
