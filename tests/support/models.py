"""Networks for the tests."""

import itertools

import numpy as np

from snake_env.modes import mode_table
from snake_env.networks.model_file import Model
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.policies.value import pretrained
from snake_env.sim.observation import observation_size


def model_of(seed: int = 0, n_joints: int = 8, kind: str = "policy") -> Model:
    """A small network of random weights."""
    rng = np.random.default_rng(seed)
    outputs = len(mode_table(n_joints)) if kind == "policy" else 1
    sizes = [observation_size(n_joints), 12, outputs]
    network = Network(
        [rng.normal(size=s).astype(np.float32) for s in itertools.pairwise(sizes)],
        [rng.normal(size=size).astype(np.float32) for size in sizes[1:]],
    )
    return Model(kind, SnakeParams(n_joints=n_joints), network)


def unsure() -> Network:
    """A policy that ships, with noise in its weights: it loses many tasks, but not all."""
    model = pretrained(SnakeParams(), "imitate")
    assert model is not None
    first, *others = model.network.weights
    noise = np.random.default_rng(0).normal(scale=0.3, size=first.shape)
    return Network([first + noise.astype(np.float32), *others], model.network.biases)
