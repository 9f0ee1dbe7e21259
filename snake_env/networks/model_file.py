"""Model files: a network in safetensors, whose header holds a manifest that says what it is.

Nothing in them is ever executed: the tensors are plain numbers and the manifest plain text.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from snake_env.errors import InvalidInputError, SnakeEnvError
from snake_env.modes import mode_table
from snake_env.networks.network import ACTIVATIONS, Network
from snake_env.networks.symmetry import Images
from snake_env.params import SnakeParams
from snake_env.sim.observation import observation_rows, observation_size
from snake_env.system.files import write_atomically

SCHEMAS = (2, 3, 4)
"""Of files that can be read; the last one is written. Networks of schema 2 have ReLU; those of 2 and 3
see both images, but for a ``quick-value`` (canonical) and what is not ``symmetric`` (given)."""
_CRITIC = "critic."
LARGEST_FILE = 256 * 2**20
"""Larger files are no models of this package [bytes]."""
LARGEST_OUTPUT = 1e30
"""Weights that may lead to larger outputs are refused: float32 would overflow."""
REWARD_PER_LOGIT = 0.03
"""What a logit of one is worth in reward: logits times this are action values.

Every policy's file holds logits, so PPO, DQN and imitation can each begin with what another one has
learned."""
Kind = Literal["value", "policy"]
"""What the outputs are: the intervals that a state still needs, or a logit for each mode."""


@dataclass(frozen=True, eq=False)
class Model:
    """A trained network and what it is for.

    Attributes:
        kind: What its outputs are.
        params: The constants that it was trained with.
        network: Takes observations.
        made: How it was made and what it is good for, as recorded in the manifest.
        critic: A value network for the same robot, which ranks the ends of the modes that the policy
            prefers; a model of the kind ``value``, or None.
        images: Which image of a state its network is asked about.
        action_values: Whether a policy's logits are action values, so that it can rank states
            without a critic.
        sha256: Of its file; empty where it has none.
    """

    kind: Kind
    params: SnakeParams
    network: Network
    made: Mapping[str, Any] = field(default_factory=dict)
    critic: Model | None = None
    images: Images = "canonical"
    action_values: bool = False
    sha256: str = ""

    def check(self, params: SnakeParams, kind: Kind, *, transfer: bool = False) -> None:
        """Checks whether the model can be used.

        Args:
            params: The constants that it will be used with.
            kind: The kind that it must be of.
            transfer: Whether constants may differ from those it was trained with; ``n_joints`` may
                not, as the network's size depends on it.

        Raises:
            InvalidInputError: It is of another kind, or for other constants; the message names each.
        """
        if self.kind != kind:
            raise InvalidInputError("model.kind", self.kind, kind)
        if params.n_joints != self.params.n_joints:
            expected = f"{self.params.n_joints}, as the model was trained for"
            raise InvalidInputError("n_joints", params.n_joints, expected)
        differences = {} if transfer else params.differences(self.params)
        if differences:
            here, trained = zip(*differences.values(), strict=True)
            single = len(differences) == 1
            raise InvalidInputError(
                ", ".join(differences),
                here[0] if single else here,
                f"{trained[0] if single else trained}, as the model was trained with "
                "(transfer=1 accepts other constants)",
            )


def write_model(path: Path, model: Model) -> None:
    """Writes a model to ``path`` (``.safetensors``), atomically.

    Raises:
        InvalidInputError: Its numbers can't be used.
    """
    models = [model] if model.critic is None else [model, model.critic]
    for each in models:
        _check_numbers(path, each.network)
    tensors = _tensors(model.network)
    if model.critic is not None:
        tensors |= {_CRITIC + name: t for name, t in _tensors(model.critic.network).items()}
    manifest = {
        "schema": SCHEMAS[-1],
        **_about(model),
        "action_values": model.action_values,
        "params": dataclasses.asdict(model.params),
        "observation": [list(row) for row in observation_rows(model.params.n_joints)],
        "made": dict(model.made),
    }
    if model.critic is not None:
        manifest["critic"] = _about(model.critic)
    manifest = json.loads(json.dumps(manifest))  # as it will be read
    manifest["sha256"] = _digest(manifest, _split(save(tensors))[1])
    # one key: with more of them their order would be random, and so would the file's bytes
    data = save(tensors, metadata={"manifest": json.dumps(manifest)})
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, data)


def read_model(path: Path) -> Model:
    """Reads a model.

    Raises:
        InvalidInputError: The file is missing, damaged, altered, or of another schema.
    """
    if path.suffix != ".safetensors":
        raise _bad(path, "a .safetensors file")
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise _bad(path, f"a file of at most {LARGEST_FILE} bytes")
        data = path.read_bytes()
    except OSError as error:
        missing = isinstance(error, FileNotFoundError)
        hint = "; a training writes its first model with its first checkpoint" if missing else ""
        raise _bad(path, f"a file that can be read ({error.strerror}{hint})") from None
    manifest, numbers = _read_manifest(path, data)
    try:
        tensors = load(data)
    except (SafetensorError, KeyError, ValueError) as error:  # KeyError: a type that NumPy lacks
        raise _bad(path, f"a safetensors file ({error})") from None
    if _digest({k: v for k, v in manifest.items() if k != "sha256"}, numbers) != manifest["sha256"]:
        raise _bad(path, "the file as it was written (its sha256 differs)")
    manifest = {"action_values": False, **_in_this_schema(manifest)}
    params = _read_params(path, manifest["params"])
    own = {name: t for name, t in tensors.items() if not name.startswith(_CRITIC)}
    others = {name.removeprefix(_CRITIC): t for name, t in tensors.items() if name not in own}
    network = _read_network(path, manifest, params, own)
    critic = None
    if manifest["kind"] == "policy" and (about := manifest.get("critic")) is not None:
        if not isinstance(about, dict) or (about := _in_this_schema(about)).get("kind") != "value":
            raise _bad(path, "a critic of the kind value")
        about["observation"] = manifest.get("observation")
        network_of_critic = _read_network(path, about, params, others)
        critic = Model("value", params, network_of_critic, images=_read_images(path, about))
    elif others:
        raise _bad(path, "no tensors of a critic")
    return Model(
        manifest["kind"],
        params,
        network,
        manifest["made"],
        critic,
        _read_images(path, manifest),
        action_values=manifest["action_values"] is True,
        sha256=hashlib.sha256(data).hexdigest(),
    )


def _about(model: Model) -> dict[str, Any]:
    """What a manifest tells about a network."""
    return {
        "kind": model.kind,
        "network": model.network.sizes,
        "activation": model.network.activation,
        "images": model.images,
    }


def _tensors(network: Network) -> dict[str, Any]:
    """A network's arrays by the names that they have in a file."""
    tensors = {}
    for k, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        tensors[f"weight.{k}"] = np.ascontiguousarray(weight, dtype=np.float32)
        tensors[f"bias.{k}"] = np.ascontiguousarray(bias, dtype=np.float32)
    return tensors


def _split(data: bytes) -> tuple[bytes, bytes]:
    """Header and numbers of a safetensors file: the header's length is in the first eight bytes."""
    end = 8 + int.from_bytes(data[:8], "little")
    return data[8:end], data[end:]


def _digest(manifest: Mapping[str, Any], numbers: bytes) -> str:
    """SHA-256 over a manifest, its own digest left out, and the tensors' numbers."""
    text = json.dumps(manifest, sort_keys=True)
    return hashlib.sha256(text.encode() + numbers).hexdigest()


def _read_manifest(path: Path, data: bytes) -> tuple[dict[str, Any], bytes]:
    """The manifest of a model, checked field by field, and the tensors' numbers."""
    header, numbers = _split(data)
    try:
        manifest = json.loads(json.loads(header)["__metadata__"]["manifest"])
    except (ValueError, TypeError, KeyError, RecursionError):
        raise _bad(path, "a model with a manifest in its header") from None
    if not isinstance(manifest, dict) or manifest.get("schema") not in SCHEMAS:
        raise _bad(path, f"a manifest of schema {' or '.join(map(str, SCHEMAS))}")
    if _in_this_schema(manifest).get("kind") not in get_args(Kind):
        raise _bad(path, f"kind {' or '.join(get_args(Kind))}")
    wanted = {"params": dict, "made": dict, "network": list, "sha256": str}
    for name, kind in wanted.items():
        if not isinstance(manifest.get(name), kind):
            raise _bad(path, f"a manifest with {', '.join(wanted)}")
    return manifest, numbers


def _read_params(path: Path, given: dict[str, Any]) -> SnakeParams:
    names = {each.name for each in dataclasses.fields(SnakeParams)}
    if given.keys() != names:
        raise _bad(path, "the constants of this version's robot")
    try:
        return SnakeParams(**given)
    except SnakeEnvError as error:
        raise _bad(path, f"usable constants ({error})") from None


def _read_network(
    path: Path, manifest: dict[str, Any], params: SnakeParams, tensors: Mapping[str, Any]
) -> Network:
    """The network, whose size must suit the robot and whose numbers must be usable."""
    n, sizes = params.n_joints, manifest["network"]
    if manifest.get("observation") != [list(row) for row in observation_rows(n)]:
        raise _bad(path, "the rows of this version's observation")
    outputs = len(mode_table(n)) if manifest["kind"] == "policy" else 1
    if (
        not isinstance(sizes, list)
        or len(sizes) < 2
        or any(type(size) is not int or size < 1 for size in sizes)
        or (sizes[0], sizes[-1]) != (observation_size(n), outputs)
    ):
        raise _bad(path, f"a network from {observation_size(n)} to {outputs} values")
    layers = len(sizes) - 1
    wanted: dict[str, tuple[int, ...]] = {}
    for k in range(layers):
        wanted |= {f"weight.{k}": (sizes[k], sizes[k + 1]), f"bias.{k}": (sizes[k + 1],)}
    found = {name: tensor.shape for name, tensor in tensors.items()}
    if found != wanted:
        raise _bad(path, f"tensors of these shapes: {wanted}")
    if any(t.dtype != np.float32 for t in tensors.values()):
        raise _bad(path, "finite float32 numbers")
    activation = manifest["activation"]
    if activation not in ACTIVATIONS:
        raise _bad(path, f"activation {' or '.join(ACTIVATIONS)}")
    network = Network(
        activation=activation,
        weights=[tensors[f"weight.{k}"] for k in range(layers)],
        biases=[tensors[f"bias.{k}"] for k in range(layers)],
    )
    _check_numbers(path, network)
    return network


def _check_numbers(path: Path, network: Network) -> None:
    if not network.largest_output() <= LARGEST_OUTPUT:  # nor is NaN
        raise _bad(path, "finite float32 numbers, of a size that a network can work with")


def _in_this_schema(about: dict[str, Any]) -> dict[str, Any]:
    """What a manifest tells about a network, an older one in today's words."""
    about = {"network": None, "activation": "relu", **about}
    if "images" in about:
        return about
    if about.get("kind") == "quick-value":
        return {**about, "kind": "value", "images": "canonical"}
    symmetric = about.get("symmetric", True)
    images = "both" if symmetric is True else "given" if symmetric is False else None
    return {**about, "images": images}


def _read_images(path: Path, manifest: dict[str, Any]) -> Images:
    images: Images = manifest["images"]
    if images in get_args(Images):
        return images
    raise _bad(path, f"images {' or '.join(get_args(Images))}")


def _bad(path: Path, expected: str) -> InvalidInputError:
    return InvalidInputError("model", str(path), expected)
