"""Value networks that become part of a policy's model file."""

from __future__ import annotations

from pathlib import Path

from snake_env.networks.model_file import Model, read_model
from snake_env.params import SnakeParams


def read_critic(file: Path, params: SnakeParams, *, transfer: bool) -> Model:
    """The value network that a policy's ``+critic`` is to rank by.

    Raises:
        InvalidInputError: It is none, or one for other constants.
    """
    model = read_model(file)
    model.check(params, "value" if model.kind == "policy" else model.kind, transfer=transfer)
    return model
