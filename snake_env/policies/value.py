"""Value functions: how many intervals a state still needs until the target is reached."""

from __future__ import annotations

import functools
import importlib.resources
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from snake_env.envs.reward import potential
from snake_env.networks.model_file import Model, read_model
from snake_env.networks.network import Network
from snake_env.networks.symmetry import CanonicalNetwork, SymmetricNetwork
from snake_env.params import SnakeParams
from snake_env.sim.observation import observe
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
    """A trained network, asked about each state and its mirror image, or about one of them.

    Args:
        model: Of the kind ``value`` or ``quick-value``.
        params: The constants.

    Raises:
        InvalidInputError: The model is not for these robots, or of another kind.
    """

    def __init__(self, model: Model, params: SnakeParams) -> None:
        quick = model.kind == "quick-value"
        model.check(params, "quick-value" if quick else "value")
        self._params = params
        asked = CanonicalNetwork if quick else SymmetricNetwork
        self._asked = asked(model.network, params.n_joints)

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
        estimates = self._asked(observations)[:, 0].astype(np.float64)
        estimates[reached] = 0.0
        return estimates


@functools.lru_cache(maxsize=4)
def network_value(network: Network, params: SnakeParams) -> NetworkValue:
    """The value function of a network that is in no file."""
    return NetworkValue(Model("value", params.n_joints, network), params)


@functools.lru_cache(maxsize=16)
def pretrained(name: str, n_joints: int, head_contact: bool) -> Model | None:
    """The shipped model of a policy for such robots; None where there is none."""
    variant = name if head_contact else f"{name}-narrow"
    suffix = "" if n_joints == 8 else f"-{n_joints}"
    with importlib.resources.as_file(importlib.resources.files("snake_env")) as package:
        path = Path(package) / "pretrained" / f"{variant}{suffix}.safetensors"
        return read_model(path) if path.is_file() else None


def guide(params: SnakeParams) -> Model | None:
    """The shipped network that guides planner and teachers for such robots; None where there is none.

    That is ``lookahead``: large, as many states share its cost. Robots without one have ``value`` for
    this too, the network of the policy of that name, in which every decision waits for it.
    """
    robots = (params.n_joints, params.head_contact)
    return pretrained("lookahead", *robots) or pretrained("value", *robots)


@functools.lru_cache(maxsize=16)
def load_value(params: SnakeParams) -> ValueFunction:
    """What :func:`guide` says, or :class:`PhaseValue` where there is none."""
    model = guide(params)
    return PhaseValue(params) if model is None else NetworkValue(model, params)
