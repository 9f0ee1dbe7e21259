"""The canonical image of states in PyTorch, as networks in NumPy see it."""

from __future__ import annotations

import torch
from torch import nn

from snake_env.networks.symmetry import canonical_sign_index, joints_observed, mirror


class CanonicalImage(nn.Module):
    """From observations to those of the canonical images, as :class:`CanonicalNetwork` sees them.

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
        self._sign_index = canonical_sign_index(size)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Shape (N, size), as the observations."""
        as_it_is = observations[:, self._sign_index, None] >= 0.0
        return torch.where(as_it_is, observations, observations[:, self.order] * self.sign)
