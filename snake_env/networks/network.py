"""Multi-layer perceptrons in NumPy: what a trained model needs to run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Network:
    """Linear layers with rectifiers between them.

    Attributes:
        weights: One matrix for each layer, shape (inputs, outputs).
        biases: One vector for each layer, shape (outputs,).
    """

    weights: Sequence[Float32Array]
    biases: Sequence[Float32Array]

    def __call__(self, x: Float32Array) -> Float32Array:
        """Outputs for inputs of shape (inputs,) or (N, inputs)."""
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = x @ weight
            x += bias
            np.maximum(x, 0.0, out=x)
        return x @ self.weights[-1] + self.biases[-1]

    @property
    def sizes(self) -> list[int]:
        """Values at the input, in each hidden layer and at the output."""
        return [self.weights[0].shape[0], *(weight.shape[1] for weight in self.weights)]
