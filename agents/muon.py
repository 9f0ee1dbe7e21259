"""Muon (K. Jordan et al., 2024), by which networks are fitted: it learns more from a batch than Adam.

Its steps turn all directions of a matrix alike. PyTorch has it since 2.9, and this package needs only
2.8.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import nn
from torch.optim import Adam, Optimizer
from torch.optim.lr_scheduler import LinearLR

_A, _B, _C = 3.4445, -4.775, 2.0315  # of the quintic that pushes singular values towards one
_ITERATIONS = 5


class Muon(Optimizer):
    """Nesterov's momentum, orthogonalised, and scaled so that Adam's learning rates fit it.

    That is ``torch.optim.Muon(..., adjust_lr_fn="match_rms_adamw")``, but in single precision: bfloat16
    is slow on processors that are not made for it, and on others
    :func:`agents.mlp.bfloat16_matmul` does as much.

    Args:
        matrices: What is learned: parameters with two dimensions.
        lr: Learning rate.
        weight_decay: Share of itself, times the learning rate, by which a matrix shrinks in each step.
        momentum: Share of the momentum that is kept in each step.
    """

    def __init__(
        self,
        matrices: Iterable[nn.Parameter],
        lr: float,
        weight_decay: float = 0.0,
        momentum: float = 0.95,
    ) -> None:
        given = {"lr": lr, "weight_decay": weight_decay, "momentum": momentum}
        super().__init__(matrices, given)

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Changes the matrices by their gradients."""
        for group in self.param_groups:
            for matrix in group["params"]:
                state = self.state[matrix]
                if not state:
                    state["momentum"] = torch.zeros_like(matrix)
                kept: torch.Tensor = state["momentum"]
                kept.lerp_(matrix.grad, 1.0 - group["momentum"])
                ahead = matrix.grad.lerp(kept, group["momentum"])
                size = 0.2 * math.sqrt(max(matrix.shape))  # that of Adam's steps
                matrix.mul_(1.0 - group["lr"] * group["weight_decay"])
                matrix.add_(orthogonalised(ahead), alpha=-group["lr"] * size)


def orthogonalised(matrix: torch.Tensor) -> torch.Tensor:
    """The matrix with its singular values near one, by Newton-Schulz iterations.

    They come to lie between 0.7 and 1.2, but where they are tiny beside the largest.
    """
    wide = matrix.shape[0] <= matrix.shape[1]
    x = matrix if wide else matrix.T
    x = x / x.norm().clamp(min=1e-7)
    for _ in range(_ITERATIONS):
        gram = x @ x.T
        x = torch.addmm(x, torch.addmm(gram, gram, gram, beta=_B, alpha=_C), x, beta=_A)
    return x if wide else x.T


class Descent:
    """The steps of a fit: Muon for matrices, Adam for biases.

    Args:
        module: What is fitted.
        learning_rate: The largest; it falls to a hundredth of it.
        steps: How many steps there will be.
        weight_decay: That of the matrices.
    """

    def __init__(
        self, module: nn.Module, learning_rate: float, steps: int, weight_decay: float
    ) -> None:
        matrices, biases = ([p for p in module.parameters() if p.ndim == d] for d in (2, 1))
        self._optimizers: list[Optimizer] = [
            Muon(matrices, learning_rate, weight_decay),
            Adam(biases, learning_rate, fused=True),
        ]
        self._schedules = [LinearLR(each, 1.0, 0.01, steps) for each in self._optimizers]

    def step(self, loss: torch.Tensor) -> None:
        """One step down the loss."""
        for optimizer in self._optimizers:
            optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        for optimizer, schedule in zip(self._optimizers, self._schedules, strict=True):
            optimizer.step()
            schedule.step()
