"""Networks in PyTorch that are asked about both images, or one, as those in NumPy."""

from __future__ import annotations

import torch
from torch import nn

from snake_env.networks.symmetry import canonical_sign_index, joints_observed, mirror


class Mirror(nn.Module):
    """Observations, and behind them those of the mirror images.

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

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """From shape (N, size) to (2 N, size)."""
        return torch.cat([observations, observations[:, self.order] * self.sign])


def mean_of_both(outputs: torch.Tensor) -> torch.Tensor:
    """The mean of what a network says of states and of their images, as :class:`Mirror` orders them."""
    of_states, of_images = outputs.chunk(2)
    return 0.5 * (of_states + of_images)


class _Asked(nn.Module):
    """A network, and what makes mirror images for it.

    Args:
        network: Linear layers with rectifiers between them; the first takes observations.
    """

    def __init__(self, network: nn.Sequential) -> None:
        super().__init__()
        self.network = network
        first = network[0]
        assert isinstance(first, nn.Linear)
        self._mirror = Mirror(first.in_features)


class Symmetric(_Asked):
    """A network that is asked about observations and about their mirror images."""

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """The mean of the answers, shape (N, outputs)."""
        return mean_of_both(self.network(self._mirror(observations)))


class Canonical(_Asked):
    """A network that is asked about one image of each state, as CanonicalNetwork."""

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Its answers, shape (N, outputs)."""
        as_they_are, images = self._mirror(observations).chunk(2)
        canonical = observations[:, canonical_sign_index(observations.shape[1]), None] >= 0.0
        answers: torch.Tensor = self.network(torch.where(canonical, as_they_are, images))
        return answers
