"""Checks of options that many methods have."""

from __future__ import annotations

import math
from typing import Any

import torch

from snake_env.errors import InvalidInputError, UnknownNameError

_LARGEST_LAYER = 16_384
_MOST_LAYERS = 16


def check_positive(options: Any, *names: str) -> None:
    """Raises InvalidInputError unless these fields are positive, and finite."""
    for name in names:
        if not 0 < getattr(options, name) < math.inf:
            raise InvalidInputError(name, getattr(options, name), "a positive number")


def check_not_negative(options: Any, *names: str) -> None:
    """Raises InvalidInputError unless these fields are zero or positive, and finite."""
    for name in names:
        if not 0 <= getattr(options, name) < math.inf:
            raise InvalidInputError(name, getattr(options, name), "zero or a positive number")


def check_share(options: Any, *names: str) -> None:
    """Raises InvalidInputError unless these fields are from 0 to 1."""
    for name in names:
        if not 0.0 <= getattr(options, name) <= 1.0:
            raise InvalidInputError(name, getattr(options, name), "a number from 0 to 1")


def check_device(device: str) -> None:
    """Raises a SnakeEnvError unless networks can learn there."""
    if device not in ("cpu", "cuda"):
        raise UnknownNameError("device", device, ["cpu", "cuda"])
    if device == "cuda" and not torch.cuda.is_available():
        raise InvalidInputError("device", device, "cpu: there is no CUDA device")


def check_hidden(hidden: tuple[int, ...]) -> None:
    """Raises InvalidInputError unless these can be the sizes of hidden layers."""
    if not hidden or min(hidden) < 1:
        raise InvalidInputError("hidden", hidden, "one or more positive sizes")
    if max(hidden) > _LARGEST_LAYER or len(hidden) > _MOST_LAYERS:
        expected = f"at most {_MOST_LAYERS} sizes of at most {_LARGEST_LAYER:,}"
        raise InvalidInputError("hidden", hidden, expected)


def check_at_most(options: Any, most: int, *names: str) -> None:
    """Raises InvalidInputError where a field asks for more than any machine has memory for."""
    for name in names:
        if getattr(options, name) > most:
            raise InvalidInputError(name, getattr(options, name), f"at most {most:,}")
