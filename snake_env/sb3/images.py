"""Images of states in PyTorch, as networks in NumPy see them (:mod:`snake_env.networks.symmetry`)."""

from __future__ import annotations

import torch
from torch import nn

from snake_env.networks.symmetry import canonical_sign_index, joints_observed, mirror


class _Images(nn.Module):
    """What knows the mirror images of observations.

    Args:
        size: Values in an observation.
    """

    order: torch.Tensor
    sign: torch.Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        order, sign = mirror(joints_observed(size))
        self.register_buffer("order", torch.tensor(order), persistent=False)
        self.register_buffer("sign", torch.tensor(sign), persistent=False)

    def mirrored(self, observations: torch.Tensor) -> torch.Tensor:
        """The mirror images, shape (N, size)."""
        return observations[:, self.order] * self.sign


class CanonicalImage(_Images):
    """From observations to those of the canonical images, shape (N, size)."""

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """An observation, or its mirror image."""
        sign_index = canonical_sign_index(observations.shape[1])
        as_it_is = observations[:, sign_index, None] >= 0.0
        return torch.where(as_it_is, observations, self.mirrored(observations))


class BothImages(_Images):
    """From observations to those and behind them their mirror images, shape (2 N, size)."""

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """The observations twice."""
        return torch.cat([observations, self.mirrored(observations)])


class MeanOfBoth(nn.Module):
    """The mean of what a network says of states and of their images, as BothImages orders them."""

    def forward(self, outputs: torch.Tensor) -> torch.Tensor:
        """From shape (2 N, outputs) to (N, outputs)."""
        of_states, of_images = outputs.chunk(2)
        return 0.5 * (of_states + of_images)
