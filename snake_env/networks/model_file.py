"""Model files: a network in safetensors, with a JSON manifest beside it that says what it is.

Nothing in them is ever executed: the tensors are plain numbers and the manifest plain text.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from snake_env.errors import InvalidInputError
from snake_env.modes import mode_table
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.sim.observation import observation_rows, observation_size

SCHEMA = 1
Kind = Literal["value", "quick-value", "policy"]
"""What the outputs are: the intervals that a state still needs, or a preference for each mode.

Networks are asked about a state and its mirror image, and the mean counts; a ``quick-value`` is asked
about one of them."""


@dataclass(frozen=True, eq=False)
class Model:
    """A trained network and what it is for.

    Attributes:
        kind: What its outputs are.
        n_joints: Joints of the robots that it is for.
        network: Takes observations.
        made: How it was made and what it is good for, as the manifest tells it.
        sha256: Of its file; empty where it has none.
    """

    kind: Kind
    n_joints: int
    network: Network
    made: Mapping[str, Any] = field(default_factory=dict)
    sha256: str = ""

    def check(self, params: SnakeParams, kind: Kind) -> None:
        """Raises InvalidInputError unless the model is of this kind and for these robots."""
        if self.kind != kind:
            raise InvalidInputError("model.kind", self.kind, kind)
        if params.n_joints != self.n_joints:
            raise InvalidInputError("n_joints", params.n_joints, f"{self.n_joints}: the model's")


def write_model(path: Path, model: Model) -> None:
    """Writes ``path`` (``.safetensors``) and the manifest beside it (``.json``)."""
    tensors = {}
    for k, (weight, bias) in enumerate(
        zip(model.network.weights, model.network.biases, strict=True)
    ):
        tensors[f"weight.{k}"] = np.ascontiguousarray(weight, dtype=np.float32)
        tensors[f"bias.{k}"] = np.ascontiguousarray(bias, dtype=np.float32)
    data = save(tensors)
    manifest = {
        "schema": SCHEMA,
        "kind": model.kind,
        "n_joints": model.n_joints,
        "observation": [list(row) for row in observation_rows(model.n_joints)],
        "network": model.network.sizes,
        "sha256": hashlib.sha256(data).hexdigest(),
        "made": dict(model.made),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    for file, content in (
        (path, data),
        (path.with_suffix(".json"), (json.dumps(manifest, indent=1) + "\n").encode()),
    ):
        partial = file.with_name(f".{file.name}.partial")
        partial.write_bytes(content)
        partial.replace(file)


def read_model(path: Path) -> Model:
    """Reads a model.

    Args:
        path: The ``.safetensors`` file; its manifest lies beside it.

    Raises:
        InvalidInputError: A file is missing, damaged, altered, or of another schema.
    """
    manifest = _read_manifest(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise _bad(path, f"a file that can be read ({error.strerror})") from None
    if hashlib.sha256(data).hexdigest() != manifest["sha256"]:
        raise _bad(path, "the file that its manifest was written for (the sha256 differs)")
    try:
        tensors = load(data)
    except (SafetensorError, KeyError) as error:  # KeyError: a type that NumPy lacks
        raise _bad(path, f"a safetensors file ({error})") from None
    sizes: list[int] = manifest["network"]
    layers = len(sizes) - 1
    wanted: dict[str, tuple[int, ...]] = {}
    for k in range(layers):
        wanted[f"weight.{k}"] = (sizes[k], sizes[k + 1])
        wanted[f"bias.{k}"] = (sizes[k + 1],)
    if {name: tensor.shape for name, tensor in tensors.items()} != wanted:
        raise _bad(path, f"the tensors {wanted}")
    if any(t.dtype != np.float32 or not np.isfinite(t).all() for t in tensors.values()):
        raise _bad(path, "finite float32 numbers")
    network = Network(
        weights=[tensors[f"weight.{k}"] for k in range(layers)],
        biases=[tensors[f"bias.{k}"] for k in range(layers)],
    )
    return Model(
        manifest["kind"], manifest["n_joints"], network, manifest["made"], manifest["sha256"]
    )


def read_network(path: Path, params: SnakeParams, kind: Kind) -> Network:
    """The network of a model that must be of this kind and for these robots.

    Raises:
        InvalidInputError: As :func:`read_model` and :meth:`Model.check`.
    """
    model = read_model(path)
    model.check(params, kind)
    return model.network


def _read_manifest(path: Path) -> dict[str, Any]:
    """The manifest of a model, checked field by field."""
    if not path.name:
        raise _bad(path, "a .safetensors file")
    file = path.with_suffix(".json")
    try:
        manifest = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise _bad(file, f"the model's manifest ({error.strerror})") from None
    except (ValueError, RecursionError):
        raise _bad(file, "a manifest in JSON") from None
    if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
        raise _bad(file, f"a manifest of schema {SCHEMA}")
    kind, n, sizes = (manifest.get(key) for key in ("kind", "n_joints", "network"))
    if kind not in get_args(Kind):
        raise _bad(file, f"kind {' or '.join(get_args(Kind))}")
    if type(n) is not int or not 5 <= n <= 16:
        raise _bad(file, "n_joints from 5 to 16")
    if manifest.get("observation") != [list(row) for row in observation_rows(n)]:
        raise _bad(file, "the rows of this version's observation")
    outputs = len(mode_table(n)) if kind == "policy" else 1
    if (
        not isinstance(sizes, list)
        or len(sizes) < 2
        or any(type(size) is not int or size < 1 for size in sizes)
        or (sizes[0], sizes[-1]) != (observation_size(n), outputs)
    ):
        raise _bad(file, f"a network from {observation_size(n)} to {outputs} values")
    if not isinstance(manifest.get("sha256"), str) or not isinstance(manifest.get("made"), dict):
        raise _bad(file, "the fields sha256 and made")
    return manifest


def _bad(path: Path, expected: str) -> InvalidInputError:
    return InvalidInputError("model", str(path), expected)
