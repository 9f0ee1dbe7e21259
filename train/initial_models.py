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
    if model.images == "given" or model.network.activation != "relu":
        expected = "a model of python -m train (ReLU, mirror-symmetric)"
        raise InvalidInputError("model", str(file), expected)
    return model
