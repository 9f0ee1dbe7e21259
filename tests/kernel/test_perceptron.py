"""The compiled perceptron: its formula, and that nothing beside an input matters to its outputs."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from snake_env import ModeTable, SnakeParams, load_policy
from snake_env.kernel.perceptron import GROUP, Perceptron
from snake_env.networks.network import FEW, Network
from snake_env.sim.tasks import random_suite
from tests.support.models import random_network

_SIZES = st.lists(st.integers(1, 90), min_size=2, max_size=5)
_COUNTS = st.integers(1, 2 * GROUP + 1)


def _layers(sizes: list[int], seed: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    network = random_network(sizes, seed, scale=None)
    return network.weights, network.biases


def _inputs(sizes: list[int], count: int, seed: int) -> NDArray[np.float32]:
    x = np.random.default_rng(seed + 1).normal(size=(count, sizes[0]))
    return x.astype(np.float32)


def _formula(weights: list[np.ndarray], biases: list[np.ndarray], x: np.ndarray) -> np.ndarray:
    """In double precision."""
    values = x.astype(np.float64)
    for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        values = (np.maximum(values, 0.0) if k else values) @ weight.astype(np.float64) + bias
    return values


@given(_SIZES, _COUNTS, st.integers(0, 99))
def test_perceptron__is_its_formula(sizes: list[int], count: int, seed: int) -> None:
    weights, biases = _layers(sizes, seed)
    x = _inputs(sizes, count, seed)
    before = x.copy()
    outputs = Perceptron(weights, biases)(x)
    assert outputs.shape == (count, sizes[-1])
    assert outputs.dtype == np.float32
    assert outputs == pytest.approx(_formula(weights, biases, x), rel=1e-5, abs=1e-5)
    assert np.array_equal(x, before)


@given(_SIZES, _COUNTS, st.integers(0, 99))
def test_outputs__depend_on_their_own_input_alone(sizes: list[int], count: int, seed: int) -> None:
    perceptron = Perceptron(*_layers(sizes, seed))
    x = _inputs(sizes, count, seed)
    together = perceptron(x)
    assert np.isnan(perceptron(np.full_like(x, np.nan))).all()  # leaves nothing behind
    for k in range(count):
        assert np.array_equal(perceptron(x[k : k + 1])[0], together[k])
    assert np.array_equal(perceptron(x[::-1]), together[::-1])


def test_no_input__no_output() -> None:
    assert Perceptron(*_layers([5, 8, 3], 0))(np.empty((0, 5), np.float32)).shape == (0, 3)


@pytest.mark.parametrize("size", [4, 6, 64, 1000])
def test_inputs_of_another_size__are_refused(size: int) -> None:
    perceptron = Perceptron(*_layers([5, 8, 3], 0))
    with pytest.raises(ValueError, match=f"^inputs of 5 values, not {size}$"):
        perceptron(np.zeros((2, size), np.float32))


def test_outputs__are_the_callers_own() -> None:
    sizes = [5, 8, 3]
    perceptron = Perceptron(*_layers(sizes, 0))
    x = _inputs(sizes, 2, 0)
    first = perceptron(x)
    kept = first.copy()
    perceptron(_inputs(sizes, 2, 1))
    assert np.array_equal(first, kept)


def test_threads__do_not_share_what_is_written() -> None:
    sizes = [99, 256, 99]
    network = Network(*_layers(sizes, 0))
    inputs = [_inputs(sizes, 1 + k % GROUP, k) for k in range(400)]
    expected = [network(x) for x in inputs]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(network, inputs))
    assert all(map(np.array_equal, found, expected))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))])
def test_copies_of_a_network_that_was_used__give_the_same(copied: object) -> None:
    sizes = [9, 20, 4]
    network, x = Network(*_layers(sizes, 3)), _inputs(sizes, FEW, 3)
    expected = network(x)
    assert callable(copied)
    again = copied(network)
    del network
    assert np.array_equal(again(x), expected)


@pytest.mark.parametrize("name", ["ppo", "ppo+critic"])
def test_decisions__do_not_wait_for_it(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    params = SnakeParams()
    policy = load_policy(name, params)
    monkeypatch.setattr("snake_env.networks.network.Perceptron", None)  # from here on: an error
    policy.reset(0)
    state = random_suite(1, 3, params).initial(0, params)
    assert policy.select_mode(state) in ModeTable(8).valid(1)


def test_networks__give_few_inputs_what_they_give_many() -> None:
    sizes = [99, 64, 99]
    network, x = Network(*_layers(sizes, 5)), _inputs(sizes, FEW + 1, 5)
    assert network(x[:FEW]) == pytest.approx(network(x)[:FEW], rel=1e-5, abs=1e-5)
