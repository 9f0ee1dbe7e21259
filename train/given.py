"""Model files that a command begins with, or that become part of a policy's own."""

from __future__ import annotations

from pathlib import Path

from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import Kind, Model, read_model
from snake_env.params import SnakeParams


def read_checked(file: Path, params: SnakeParams, kind: Kind, *, transfer: bool) -> Model:
    """A model of a kind, for a robot.

    Raises:
        InvalidInputError: It is of another kind, for other constants, or no network as those that are
            trained here.
    """
    model = read_model(file)
    model.check(params, kind, transfer=transfer)
    if not model.symmetric or model.network.activation != "relu":
        expected = "a model of python -m train: with ReLU, and asked about mirror images"
        raise InvalidInputError("model", str(file), expected)
    return model


def read_critic(file: Path, params: SnakeParams, *, transfer: bool) -> Model:
    """The value network that a policy's ``+critic`` is to rank by, a large one or a small one.

    Raises:
        InvalidInputError: It is none, or one for other constants.
    """
    model = read_model(file)
    model.check(params, "value" if model.kind == "policy" else model.kind, transfer=transfer)
    return model
