"""Multi-layer perceptrons without PyTorch: what a trained model needs to run.

In NumPy, or compiled where there are few inputs, as there are in a decision.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from snake_env.kernel.perceptron import Perceptron
from snake_env.state import read_only, remade

Float32Array = NDArray[np.float32]
Activation = Literal["relu", "tanh"]
ACTIVATIONS: tuple[Activation, ...] = get_args(Activation)
FEW = 16
"""Up to this many rows the compiled network is faster than NumPy."""


@dataclass(frozen=True, eq=False)
class Network:
    """Linear layers with an activation function between them. The arrays are read-only.

    Attributes:
        weights: One matrix for each layer, shape (inputs, outputs).
        biases: One vector for each layer, shape (outputs,).
        activation: The function.
    """

    weights: Sequence[Float32Array]
    biases: Sequence[Float32Array]
    activation: Activation = "relu"

    def __post_init__(self) -> None:
        for name in ("weights", "biases"):
            object.__setattr__(self, name, tuple(map(read_only, getattr(self, name))))

    def __reduce__(self) -> tuple[Any, ...]:
        return remade(self)

    def __call__(self, x: Float32Array) -> Float32Array:
        """Outputs for inputs of shape (inputs,) or (N, inputs)."""
        if x.ndim == 2 and len(x) <= FEW and self._compiled is not None:
            return self._compiled(x)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = x @ weight
            x += bias
            self._activate(x)
        return x @ self.weights[-1] + self.biases[-1]

    def prepared(self) -> Network:
        """The network, compiled or loaded for few inputs before decisions wait for it."""
        _ = self._compiled
        return self

    @functools.cached_property
    def _compiled(self) -> Perceptron | None:
        return Perceptron(self.weights, self.biases) if self.activation == "relu" else None

    def _activate(self, x: Float32Array) -> None:
        """Replaces the outputs of a layer by what the next one is given."""
        if self.activation == "relu":
            np.maximum(x, 0.0, out=x)
        else:
            np.tanh(x, out=x)

    def scaled(self, factor: float) -> Network:
        """The network with its outputs multiplied by a factor."""
        *weights, last = self.weights
        *biases, offset = self.biases
        number = np.float32(factor)
        return Network([*weights, last * number], [*biases, offset * number], self.activation)

    @property
    def sizes(self) -> list[int]:
        """Values at the input, in each hidden layer and at the output."""
        return [self.weights[0].shape[0], *(weight.shape[1] for weight in self.weights)]

    def largest_output(self) -> float:
        """No output is larger in size, hidden ones included, for inputs within [-1, 1].

        NaN where a weight is NaN.
        """
        largest = sizes = np.ones(self.weights[0].shape[0])
        for weight, bias in zip(self.weights, self.biases, strict=True):
            sizes = sizes @ np.abs(weight.astype(np.float64)) + np.abs(bias.astype(np.float64))
            largest = np.append(largest, sizes)
        return float(largest.max())
