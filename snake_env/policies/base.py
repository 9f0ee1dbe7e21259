"""The one interface of everything that chooses modes."""

from __future__ import annotations

from typing import Any, Protocol

from snake_env.networks.model_file import Model
from snake_env.state import SnakeState


class Policy(Protocol):
    """Chooses modes."""

    @property
    def rollouts(self) -> int:
        """Model roll-outs spent so far (one mode predicted over one interval each).

        They are the cost of the decisions, independent of the machine.
        """

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode. A policy that draws random numbers draws them from ``seed``."""

    def select_mode(self, state: SnakeState) -> int:
        """Index of the mode for the next interval: always one that the phase allows."""


def models_of(user: Any) -> tuple[Model, ...]:
    """The models that a policy or a value function of this package works with."""
    models = getattr(user, "models", ())  # a policy from elsewhere may have anything of that name
    own = isinstance(models, tuple) and all(isinstance(each, Model) for each in models)
    return models if own else ()


CANDIDATES = 8
"""Modes that a policy has simulated at a time: one block of the kernel, or two of four lanes."""
