"""The networks that are trained, in PyTorch, and their way to and from NumPy."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager

import torch
from torch import nn

from snake_env.errors import InvalidInputError, SnakeEnvError
from snake_env.networks.model_file import LARGEST_OUTPUT
from snake_env.networks.network import Network
from snake_env.sb3.model_writer import linear_layers, network_of


def build(sizes: Sequence[int]) -> nn.Sequential:
    """Linear layers with rectifiers between them.

    Args:
        sizes: Values at the input, in each hidden layer and at the output.
    """
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


@contextmanager
def bfloat16_matmul() -> Iterator[None]:
    """Rounds the factors of matrix products to bfloat16 where the processor is made for it (AMX).

    Fits then take some three fifths of the time. Weights, sums and all else keep single precision, and
    on other processors nothing changes (:func:`torch.set_float32_matmul_precision`).
    """
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


class DivergedError(SnakeEnvError):
    """Training has led to numbers that are infinite or none at all."""

    def __init__(self, learning_rate: float | None) -> None:
        super().__init__(learning_rate)
        self.learning_rate = learning_rate

    def __str__(self) -> str:
        known = "" if self.learning_rate is None else f" ({self.learning_rate:g})"
        return f"training diverged: lower --learning-rate{known}"


def to_numpy(layers: Sequence[nn.Linear], learning_rate: float | None = None) -> Network:
    """Linear layers as a network, copied.

    Args:
        layers: The layers.
        learning_rate: What they were trained with, for the error.

    Raises:
        DivergedError: They hold numbers that a model file may not.
    """
    for layer in layers:
        if not all(torch.isfinite(part).all() for part in (layer.weight, layer.bias)):
            raise DivergedError(learning_rate)
    network = network_of(layers)
    if not network.largest_output() <= LARGEST_OUTPUT:
        raise DivergedError(learning_rate)
    return network


def load_weights(layers: Sequence[nn.Linear], network: Network) -> None:
    """Gives linear layers a network's weights.

    Raises:
        InvalidInputError: The sizes differ.
    """
    sizes = [layers[0].in_features, *(layer.out_features for layer in layers)]
    if sizes != network.sizes:
        raise InvalidInputError("hidden", sizes[1:-1], f"{network.sizes[1:-1]}: the network's")
    with torch.no_grad():
        for layer, weight, bias in zip(layers, network.weights, network.biases, strict=True):
            layer.weight.copy_(torch.from_numpy(weight.T.copy()))
            layer.bias.copy_(torch.from_numpy(bias.copy()))


def from_numpy(network: Network) -> nn.Sequential:
    """A module with a network's weights."""
    module = build(network.sizes)
    load_weights(linear_layers(module), network)
    return module


def batches(count: int, size: int, epochs: int, device: str) -> Iterator[torch.Tensor]:
    """Positions of shuffled batches, on a device: ``epochs`` passes over ``count`` rows.

    What is left over of a pass waits for the next one.
    """
    for _ in range(epochs):
        shuffled = torch.randperm(count)[: count // size * size]
        yield from shuffled.reshape(-1, size).to(device)


Track = Callable[[Iterable[torch.Tensor], int], Iterable[torch.Tensor]]
"""Passes on the batches of a fit, given how many there are, and may show how far it has come."""


def untracked(batches: Iterable[torch.Tensor], total: int) -> Iterable[torch.Tensor]:
    """The batches as they are."""
    return batches


def linear_schedule(learning_rate: float) -> Callable[[float], float]:
    """A schedule of SB3's: it falls to a twentieth of ``learning_rate`` by the end."""
    return lambda remaining: learning_rate * (0.05 + 0.95 * remaining)
