"""Value functions: how many intervals a state still needs until the target is reached."""

from __future__ import annotations

import functools
import importlib.resources
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from snake_env.envs.reward import RewardWeights, potential
from snake_env.networks.model_file import REWARD_PER_LOGIT, Model, read_model
from snake_env.networks.network import Network
from snake_env.networks.symmetry import with_images
from snake_env.params import SnakeParams
from snake_env.sim.masks import action_masks
from snake_env.sim.observation import get_observation_kernel, observe
from snake_env.state import FloatArray, StateBatch


class ValueFunction(Protocol):
    """Estimates the cost-to-go of states."""

    def __call__(self, states: StateBatch) -> FloatArray:
        """Intervals that each state still needs, shape (N,); 0 where the target is reached."""


class PhaseValue:
    """Without a network: one interval for each phase left, this one by its error.

    Args:
        params: The constants.
    """

    def __init__(self, params: SnakeParams) -> None:
        self._params = params

    def __call__(self, states: StateBatch) -> FloatArray:
        """Minus the potential of the reward's shaping term."""
        return -potential(states, self._params)


class NetworkValue:
    """A trained network.

    Attributes:
        models: Its model.

    Args:
        model: Of the kind ``value``.
        params: The constants.
        transfer: Whether these may differ from the constants that the model was trained with.

    Raises:
        InvalidInputError: The model was trained with other constants, or is of another kind.
    """

    def __init__(self, model: Model, params: SnakeParams, transfer: bool = False) -> None:
        model.check(params, "value", transfer=transfer)
        self.models = (model,)
        get_observation_kernel(params.n_joints, params.head_contact)
        self._params = params
        self._network = with_images(model.network, params.n_joints, model.images)

    def __call__(self, states: StateBatch) -> FloatArray:
        """The network's estimates."""
        reached = states.phase > self._params.n_joints
        return self.of_observed(observe(states, self._params), reached)

    def of_observed(
        self, observations: NDArray[np.float32], reached: NDArray[np.bool_]
    ) -> FloatArray:
        """The same for states that have been observed.

        Args:
            observations: Shape (N, observation_size).
            reached: Where the target is reached, shape (N,).
        """
        estimates = self._network(observations)[:, 0].astype(np.float64)
        estimates[reached] = 0.0
        return estimates


class ActionValue:
    """What a policy's own action values say: a state is worth its best mode.

    Args:
        model: Of the kind ``policy``; its logits are action values, as those of ``train dqn`` and
            ``train imitate`` are.
        params: The constants.
    """

    def __init__(self, model: Model, params: SnakeParams) -> None:
        get_observation_kernel(params.n_joints, params.head_contact)
        self._params = params
        self._network = with_images(model.network, params.n_joints, model.images)

    def __call__(self, states: StateBatch) -> FloatArray:
        """The return of the best mode, in intervals."""
        logits = self._network(observe(states, self._params)).astype(np.float64)
        logits[~action_masks(states, self._params, "instant")] = -np.inf
        weights = RewardWeights()
        best = REWARD_PER_LOGIT * logits.max(axis=1)
        intervals: FloatArray = (best - weights.success) / weights.time
        intervals[states.phase > self._params.n_joints] = 0.0
        return intervals


@functools.lru_cache(maxsize=4)
def network_value(network: Network, params: SnakeParams) -> NetworkValue:
    """The value function of a network that is in no file."""
    return NetworkValue(Model("value", params, network), params)


@functools.lru_cache(maxsize=16)
def shipped(name: str) -> tuple[Model, ...]:
    """The models of a policy that ship with the package, one for each robot."""
    with importlib.resources.as_file(importlib.resources.files("snake_env")) as package:
        folder = package / "pretrained"
        files = [folder / f"{name}.safetensors", *sorted(folder.glob(f"{name}-*.safetensors"))]
        return tuple(read_model(file) for file in files if file.is_file())


def pretrained(params: SnakeParams, name: str, transfer: bool = False) -> Model | None:
    """The shipped model for a robot.

    Args:
        params: The robot's constants.
        name: The policy whose model it is.
        transfer: Whether a model that was trained with other constants serves where there is none for
            these: the one that differs least.

    Returns:
        The model; None where none ships for robots with as many joints.

    Raises:
        InvalidInputError: All that ship for as many joints were trained with other constants.
    """
    fitting = [model for model in shipped(name) if model.params.n_joints == params.n_joints]
    if not fitting:
        return None
    nearest = min(fitting, key=lambda model: len(params.differences(model.params)))
    nearest.check(params, nearest.kind, transfer=transfer)
    return nearest


@functools.lru_cache(maxsize=16)
def load_value(params: SnakeParams, transfer: bool = False) -> ValueFunction:
    """The shipped value network for a robot, or :class:`PhaseValue` where :func:`pretrained` has none.

    Raises:
        InvalidInputError: As :func:`pretrained`.
    """
    model = pretrained(params, "value", transfer=transfer)
    return PhaseValue(params) if model is None else NetworkValue(model, params, transfer)


def value_digest(params: SnakeParams, transfer: bool = False) -> str | None:
    """SHA-256 of the shipped value network that results depend on; None where there is none.

    Raises:
        InvalidInputError: It was trained with other constants, and these are not accepted.
    """
    model = pretrained(params, "value", transfer=transfer)
    return None if model is None else model.sha256
