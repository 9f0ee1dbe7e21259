"""Networks for the tests."""

import itertools
from collections.abc import Sequence

import numpy as np

from snake_env.modes import mode_table
from snake_env.networks.model_file import Model
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.policies.value import pretrained
from snake_env.sim.observation import observation_size


def random_network(sizes: Sequence[int], seed: int, scale: float | None = 1.0) -> Network:
    """A network of random numbers.

    Args:
        sizes: Of its inputs, its hidden layers and its outputs.
        seed: Decides the numbers.
        scale: Standard deviation of the weights; None: 1 over the root of a layer's inputs.
    """
    rng, pairs = np.random.default_rng(seed), list(itertools.pairwise(sizes))
    spread = [a**-0.5 if scale is None else scale for a, _ in pairs]
    return Network(
        [
            rng.normal(0.0, s, pair).astype(np.float32)
            for s, pair in zip(spread, pairs, strict=True)
        ],
        [rng.normal(size=size).astype(np.float32) for size in sizes[1:]],
    )


def same_network(one: Network, other: Network) -> bool:
    """Whether two networks have the same numbers."""
    pairs = zip([*one.weights, *one.biases], [*other.weights, *other.biases], strict=True)
    return all(np.array_equal(*pair) for pair in pairs)


def model_of(seed: int = 0, n_joints: int = 8, kind: str = "policy") -> Model:
    """A small network of random weights."""
    outputs = len(mode_table(n_joints)) if kind == "policy" else 1
    network = random_network([observation_size(n_joints), 12, outputs], seed)
    return Model(kind, SnakeParams(n_joints=n_joints), network)


def unsure() -> Network:
    """A policy that ships, with noise in its weights: it loses many tasks, but not all."""
    model = pretrained(SnakeParams(), "imitate")
    assert model is not None
    first, *others = model.network.weights
    noise = np.random.default_rng(0).normal(scale=0.3, size=first.shape)
    return Network([first + noise.astype(np.float32), *others], model.network.biases)
