"""The NumPy network: its formula, and what it has in common with PyTorch's."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.mlp import build, from_numpy, load_weights, to_numpy
from snake_env.errors import InvalidInputError
from snake_env.networks.network import ACTIVATIONS, Activation, Network
from snake_env.sb3.model_writer import linear_layers
from tests.support.models import random_network, same_network

sizes = st.lists(st.integers(1, 40), min_size=2, max_size=5)


def _inputs(layers: list[int], seed: int, rows: int = 7) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (rows, layers[0])).astype(np.float32)


def _formula(network: Network, x: np.ndarray) -> list[float]:
    """Value by value, in double precision."""
    values = [float(value) for value in x]
    last = len(network.weights) - 1
    for k, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        sums = [
            float(bias[column]) + sum(v * float(w) for v, w in zip(values, row, strict=True))
            for column, row in enumerate(weight.T)
        ]
        bend = math.tanh if network.activation == "tanh" else lambda total: max(total, 0.0)
        values = sums if k == last else [bend(total) for total in sums]
    return values


def test_network__of_two_rectifiers_is_the_absolute_value() -> None:
    network = Network(
        [np.array([[1.0, -1.0]], dtype=np.float32), np.array([[1.0], [1.0]], dtype=np.float32)],
        [np.zeros(2, dtype=np.float32), np.array([0.5], dtype=np.float32)],
    )
    for x in (-3.0, 0.0, 2.0):
        assert network(np.array([x], dtype=np.float32)).tolist() == [abs(x) + 0.5]


def test_network__without_hidden_layers_is_linear_and_may_be_negative() -> None:
    network = Network([np.array([[2.0], [-3.0]], dtype=np.float32)], [np.ones(1, np.float32)])
    assert network(np.array([[1.0, 1.0], [0.0, 2.0]], dtype=np.float32)).tolist() == [[0], [-5]]


@given(sizes, st.integers(0, 99), st.sampled_from(ACTIVATIONS))
def test_network__is_its_formula(layers: list[int], seed: int, activation: Activation) -> None:
    network = dataclasses.replace(random_network(layers, seed, scale=None), activation=activation)
    for x in _inputs(layers, seed, rows=2):
        assert network(x) == pytest.approx(np.array(_formula(network, x)), rel=1e-5, abs=1e-5)


@settings(max_examples=20)
@given(sizes, st.integers(0, 99))
def test_network__is_torchs(layers: list[int], seed: int) -> None:
    torch.manual_seed(seed)
    module = build(layers)
    x = _inputs(layers, seed)
    with torch.no_grad():
        expected = module(torch.from_numpy(x)).numpy()
    assert np.abs(to_numpy(linear_layers(module))(x) - expected).max() <= 1e-6
    with torch.no_grad():
        again = from_numpy(to_numpy(linear_layers(module)))(torch.from_numpy(x)).numpy()
    assert np.array_equal(again, expected)


@given(sizes, st.integers(0, 99))
def test_network__goes_to_torch_and_back_to_the_bit(layers: list[int], seed: int) -> None:
    network = random_network(layers, seed, scale=None)
    back = to_numpy(linear_layers(from_numpy(network)))
    assert network.sizes == back.sizes == layers
    assert same_network(network, back)
    assert {array.dtype for array in (*back.weights, *back.biases)} == {np.dtype(np.float32)}


@given(sizes, st.integers(0, 99))
def test_network__gives_one_input_what_it_gives_many(layers: list[int], seed: int) -> None:
    network, x = random_network(layers, seed, scale=None), _inputs(layers, seed)
    before = x.copy()
    many = network(x)
    assert many.shape == (7, layers[-1])
    assert many.dtype == np.float32
    for row, outputs in zip(x, many, strict=True):
        assert network(row) == pytest.approx(outputs, rel=1e-5, abs=1e-5)
    assert np.array_equal(x, before)


def test_to_numpy__copies() -> None:
    module = build([3, 4, 2])
    network = to_numpy(linear_layers(module))
    before = [array.copy() for array in (*network.weights, *network.biases)]
    with torch.no_grad():
        for parameter in module.parameters():
            parameter += 1.0
    for array, old in zip((*network.weights, *network.biases), before, strict=True):
        assert np.array_equal(array, old)


def test_from_numpy__copies() -> None:
    network = random_network([3, 4, 2], 0, scale=None)
    before = [array.copy() for array in (*network.weights, *network.biases)]
    with torch.no_grad():
        for parameter in from_numpy(network).parameters():
            parameter += 1.0
    for array, old in zip((*network.weights, *network.biases), before, strict=True):
        assert np.array_equal(array, old)


def test_load_weights__refuses_a_network_of_other_sizes() -> None:
    layers = linear_layers(build([3, 4, 2]))
    before = [array.copy() for array in to_numpy(layers).weights]
    load_weights(layers, random_network([3, 4, 2], 0, scale=None))
    assert not any(map(np.array_equal, to_numpy(layers).weights, before))
    for sizes in ([3, 5, 2], [3, 4, 4, 2], [3, 2], [2, 4, 2]):
        with pytest.raises(InvalidInputError, match=r"^hidden = \[4\]: expected .*the network's"):
            load_weights(layers, random_network(sizes, 0, scale=None))
