"""From a model of Stable-Baselines3 or sb3-contrib to a model file, which needs neither to play."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.dqn.policies import DQNPolicy
from torch import nn

from snake_env.envs.core import checked_weights
from snake_env.envs.reward import RewardWeights
from snake_env.errors import InvalidInputError
from snake_env.modes import mode_table
from snake_env.networks.model_file import PREFERENCE, Model, write_model
from snake_env.networks.network import Activation, Network
from snake_env.params import SnakeParams
from snake_env.sb3.masked import MaskedActorCriticPolicy, MaskedQNetwork
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

    That policy chooses what ``model.predict(..., deterministic=True)`` chooses, and no mode
    twice where the robot has not moved (the no-repeat rule). What PPO's critic has learned becomes the
    critic of ``+critic``.

    Args:
        model: PPO, MaskablePPO or A2C with a policy of the kind ``MlpPolicy`` or
            :class:`MaskedActorCriticPolicy`, or DQN with ``MlpPolicy`` or :class:`MaskedDQNPolicy`;
            its hidden layers have ReLU or Tanh. It has seen observations as they are, without
            ``VecNormalize``.
        path: Where to, ``.safetensors``.
        params: The robot that it was trained with; default: the preset ``paper``.
        reward_weights: What the env was given, if anything: critics count in reward. Where it has
            shaping, cost or violation terms the file gets no critic.
        made: What the file shall tell about how it was made.

    Returns:
        The file's path.

    Raises:
        InvalidInputError: A network of another kind, or for another robot.
        UnknownNameError: No such term of the reward.
    """
    robot, weights = params or SnakeParams(), checked_weights(reward_weights or {})
    policy: Any = model.policy
    critic = None
    if hasattr(policy, "mlp_extractor"):  # sb3-contrib's are no ActorCriticPolicy
        symmetric = isinstance(policy, MaskedActorCriticPolicy)
        extractor = policy.mlp_extractor
        network = _network([*extractor.policy_net, policy.action_net])
        if weights.time and not (weights.shaping or weights.cost or weights.violation):
            worth = _network([*extractor.value_net, policy.value_net])
            critic = Model("value", robot, in_intervals(worth, weights), symmetric=symmetric)
    elif isinstance(policy, DQNPolicy):
        symmetric = isinstance(policy.q_net, MaskedQNetwork)
        network = _network(list(policy.q_net.q_net)).scaled(1.0 / PREFERENCE)
    else:
        expected = "a policy of PPO, MaskablePPO, A2C or DQN"
        raise InvalidInputError("policy", type(policy).__name__, expected)
    wanted = observation_size(robot.n_joints), len(mode_table(robot.n_joints))
    if (network.sizes[0], network.sizes[-1]) != wanted:
        expected = f"from {wanted[0]} observed values to {wanted[1]} modes, as the robot has"
        raise InvalidInputError("network", network.sizes, expected)
    file = Path(path)
    write_model(file, Model("policy", robot, network, made or {}, critic, symmetric))
    return file


def in_intervals(network: Network, weights: RewardWeights) -> Network:
    """A critic's network, from reward into the intervals that a state still needs."""
    scaled = network.scaled(1.0 / weights.time)
    *biases, last = scaled.biases
    offset = np.float32(weights.success / weights.time)
    return dataclasses.replace(scaled, biases=[*biases, last - offset])


def _network(modules: Sequence[nn.Module]) -> Network:
    """Linear layers with an activation function between them, as a network."""
    layers = [module for module in modules if isinstance(module, nn.Linear)]
    kinds = {type(module) for module in modules if not isinstance(module, nn.Linear)}
    if len(kinds) > 1 or not kinds <= _ACTIVATIONS.keys():
        found = ", ".join(sorted(kind.__name__ for kind in kinds))
        raise InvalidInputError("activation_fn", found, "ReLU or Tanh")
    return network_of(layers, *(_ACTIVATIONS[kind] for kind in kinds))


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
