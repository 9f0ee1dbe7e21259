"""The networks that are trained, in PyTorch, and their way to and from NumPy."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from snake_env.network import Network


def build(sizes: Sequence[int]) -> nn.Sequential:
    """Linear layers with rectifiers between them.

    Args:
        sizes: Values at the input, in each hidden layer and at the output.
    """
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def to_numpy(module: nn.Module) -> Network:
    """The linear layers of a module, in their order, copied."""
    layers = [layer for layer in module.modules() if isinstance(layer, nn.Linear)]
    return Network(
        weights=[
            np.ascontiguousarray(layer.weight.detach().cpu().numpy().T, dtype=np.float32)
            for layer in layers
        ],
        biases=[layer.bias.detach().cpu().numpy().astype(np.float32).copy() for layer in layers],
    )


def from_numpy(network: Network) -> nn.Sequential:
    """A module with a network's weights."""
    module = build(network.sizes)
    layers = [layer for layer in module if isinstance(layer, nn.Linear)]
    with torch.no_grad():
        for layer, weight, bias in zip(layers, network.weights, network.biases, strict=True):
            layer.weight.copy_(torch.from_numpy(weight.T.copy()))
            layer.bias.copy_(torch.from_numpy(bias.copy()))
    return module
