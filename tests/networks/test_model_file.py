"""Model files: what is written is read, and nothing that was damaged, altered or made up is."""

import contextlib
import dataclasses
import hashlib
import json
import pickle
import struct
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load, save

from snake_env.errors import InvalidInputError
from snake_env.modes import mode_table
from snake_env.networks import model_file
from snake_env.networks.model_file import Model, _digest, _split, read_model, write_model
from snake_env.networks.network import Activation
from snake_env.networks.symmetry import Images, mirror
from snake_env.params import SnakeParams
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.sim.observation import observation_size, observe
from tests.support.commands import python
from tests.support.damage import PickleBomb
from tests.support.models import random_network, same_network
from tests.support.robots import PAPER, random_state

MADE = {"command": "python -m train value", "generation": 3, "note": "\u00e9 and \u2028"}
SIZES = [observation_size(8), 6, 5, 1]


def _model(kind: str = "value", n_joints: int = 8, hidden: tuple[int, ...] = (6, 5)) -> Model:
    outputs = 1 if kind == "value" else len(mode_table(n_joints))
    network = random_network([observation_size(n_joints), *hidden, outputs], n_joints)
    return Model(kind, SnakeParams(n_joints=n_joints), network, MADE)  # type: ignore[arg-type]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A good model of the kind ``value``."""
    path = tmp_path / "value.safetensors"
    write_model(path, _model())
    return path


def _manifest(path: Path) -> dict[str, Any]:
    return json.loads(json.loads(_split(path.read_bytes())[0])["__metadata__"]["manifest"])


def _put(path: Path, manifest: dict[str, Any] | str, tensors: bytes) -> None:
    """Writes a file of a manifest and tensors; a dict is signed."""
    if isinstance(manifest, dict):
        others = {key: value for key, value in manifest.items() if key != "sha256"}
        numbers = _split(tensors)[1]
        signed = manifest.get("sha256") == "signed"
        manifest = json.dumps(
            {**manifest, "sha256": _digest(others, numbers)} if signed else manifest
        )
    header = json.loads(_split(tensors)[0])
    header["__metadata__"] = {"manifest": manifest}
    path.write_bytes(_crafted(header, _split(tensors)[1]))


def _change(path: Path, **changes: Any) -> None:
    """Replaces fields of the manifest; those that become ``...`` are left out."""
    fields = {**_manifest(path), "sha256": "signed", **changes}
    kept = {key: value for key, value in fields.items() if value is not ...}
    _put(path, kept, path.read_bytes())


def _retell(path: Path, tensors: bytes) -> None:
    """Replaces the tensors, and signs them."""
    _put(path, {**_manifest(path), "sha256": "signed"}, tensors)


def _refusal(path: Path) -> str:
    """How the model is refused: in one line that names a file of it."""
    with pytest.raises(InvalidInputError) as caught:
        read_model(path)
    assert caught.value.field == "model"
    assert "\n" not in str(caught.value)
    assert path.stem in caught.value.value
    return str(caught.value)


@pytest.mark.parametrize("kind", ["value", "policy"])
@pytest.mark.parametrize("n_joints", [5, 8])
@pytest.mark.parametrize("hidden", [(), (7,), (4, 9, 2)])
def test_model__is_read_as_it_was_written(
    tmp_path: Path, kind: str, n_joints: int, hidden: tuple[int, ...]
) -> None:
    path, model = tmp_path / "new" / "a.model.safetensors", _model(kind, n_joints, hidden)
    write_model(path, model)
    again = read_model(path)
    assert (again.kind, again.params, again.made) == (kind, model.params, MADE)
    assert again.network.sizes == model.network.sizes
    assert same_network(again.network, model.network)
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["a.model.safetensors"]


def test_model__overwrites_another(path: Path) -> None:
    write_model(path, _model("policy", 5))
    assert read_model(path).kind == "policy"


def test_model__is_the_same_file_each_time(path: Path, tmp_path: Path) -> None:
    write_model(tmp_path / "again.safetensors", _model())
    assert (tmp_path / "again.safetensors").read_bytes() == path.read_bytes()
    program = (
        "import sys; from pathlib import Path; from tests.networks.test_model_file import *; "
        "from tests.networks.test_model_file import _model; "
        "write_model(Path(sys.argv[1]), _model())"
    )
    for k in range(2):  # strings hash otherwise in each process
        other = tmp_path / f"{k}.safetensors"
        python("-c", program, other)
        assert other.read_bytes() == path.read_bytes()


def test_model__survives_a_write_that_fails(path: Path) -> None:
    before = path.read_bytes()
    model = _model("policy", 5)
    with pytest.raises(TypeError):
        write_model(path, Model("policy", model.params, model.network, {"path": path}))  # not JSON
    assert path.read_bytes() == before


def test_manifest__tells_what_the_model_is(path: Path) -> None:
    manifest = _manifest(path)
    assert (manifest["schema"], manifest["kind"], manifest["network"]) == (4, "value", SIZES)
    assert manifest["params"] == json.loads(json.dumps(dataclasses.asdict(PAPER)))
    assert sum(size for _, size in manifest["observation"]) == SIZES[0]
    assert manifest["made"] == MADE
    assert read_model(path).sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_network__is_read_only(path: Path) -> None:
    for network in (read_model(path).network, pickle.loads(pickle.dumps(_model().network))):
        for array in (*network.weights, *network.biases):
            with pytest.raises(ValueError, match="read-only"):
                array[:] = 0.0


def test_check__accepts_robots_of_as_many_joints_only() -> None:
    model = _model(n_joints=5)
    model.check(SnakeParams(n_joints=5), model.kind)
    for transfer in (False, True):
        with pytest.raises(InvalidInputError, match=r"^n_joints = 8: expected 5, as the model was"):
            model.check(PAPER, model.kind, transfer=transfer)


@pytest.mark.parametrize("images", ["canonical", "both", "given"])
@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_kinds_of_networks__are_read_as_they_were_written(
    tmp_path: Path, activation: Activation, images: Images
) -> None:
    path = tmp_path / "a.safetensors"
    network = dataclasses.replace(_model("policy").network, activation=activation)
    of_critic: Images = "given" if images == "canonical" else "canonical"
    critic = dataclasses.replace(_model("value"), images=of_critic)
    model = Model("policy", PAPER, network, MADE, critic, images)
    write_model(path, model)
    again = read_model(path)
    assert (again.network.activation, again.images) == (activation, images)
    assert again.critic is not None
    assert (again.critic.network.activation, again.critic.images) == ("relu", of_critic)
    order, sign = mirror(8)
    for seed in range(6):
        state = random_state(seed, PAPER)
        ranked = NetworkPolicy(PAPER, again).ranking(state)
        seen = observe(state, PAPER)
        image = seen[order] * sign
        answers = {
            "canonical": network(seen if state.target[-1] >= 0.0 else image),
            "both": 0.5 * (network(seen) + network(image)),
            "given": network(seen),
        }[images]
        wanted = ranked[np.argsort(-answers[ranked], kind="stable")]
        assert ranked.tolist() == wanted.tolist()
    about_critic = {**_manifest(path)["critic"], "activation": "elu"}
    _change(path, critic=about_critic)
    assert "activation relu or tanh" in _refusal(path)


@pytest.mark.parametrize(
    ("before", "images"),
    [
        ({}, "both"),
        ({"symmetric": True}, "both"),
        ({"symmetric": False}, "given"),
        ({"kind": "quick-value", "symmetric": True}, "canonical"),
    ],
)
def test_files_of_before__are_asked_about_the_images_that_they_were_trained_with(
    path: Path, before: dict[str, Any], images: Images
) -> None:
    _change(path, schema=3, activation=..., images=..., **before)
    again = read_model(path)
    assert (again.kind, again.network.activation, again.images) == ("value", "relu", images)


DIFFERENT = [
    ({"l": 0.12}, r"^l = 0\.12: expected 0\.091, as the model was trained with \(transfer=1 "),
    ({"head_contact": False}, r"^head_contact = False: expected True, as "),
    ({"horizon": 50}, r"^horizon = 50: expected 100, as "),
    (
        {"dt": 0.2, "gains": (1.0, 1.0, 0.5, 0.5)},
        r"^dt, gains = \(0\.2, .*\): expected \(0\.02, \(1\.0, 1\.0, 0\.5, 2\.0\)\), as ",
    ),
]


@pytest.mark.parametrize(("changes", "message"), DIFFERENT)
def test_check__names_every_constant_that_differs(changes: dict[str, Any], message: str) -> None:
    params = PAPER.replace(**changes)
    with pytest.raises(InvalidInputError, match=message):
        _model().check(params, "value")
    _model().check(params, "value", transfer=True)
    with pytest.raises(InvalidInputError, match=r"^model\.kind"):
        _model().check(params, "policy", transfer=True)


@pytest.mark.parametrize("place", [0, 3, 8, 60, -400, -1])
def test_altered_byte__is_noticed(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)
    _refusal(path)


def test_altered_number__is_noticed(path: Path) -> None:
    data = path.read_bytes()
    for place in (len(data) - 1, len(data) - 400, data.index(b"generation") + 14):
        altered = bytearray(data)
        altered[place] ^= 1
        path.write_bytes(altered)
        assert "sha256 differs" in _refusal(path)


@pytest.mark.parametrize("length", [0, 1, 7, 8, 100, 2000, -4, -1])
def test_truncated_file__is_refused(path: Path, length: int) -> None:
    path.write_bytes(path.read_bytes()[:length])
    _refusal(path)


def test_missing_file__is_named(path: Path) -> None:
    path.unlink()
    assert "No such file" in _refusal(path)
    path.mkdir()
    assert "Is a directory" in _refusal(path)


def test_missing_manifest__is_named(path: Path) -> None:
    path.write_bytes(save({"weight.0": np.zeros((99, 1), np.float32)}))
    assert "a model with a manifest in its header" in _refusal(path)


def test_file__that_is_too_large_is_not_read(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_file, "LARGEST_FILE", 100)
    assert "a file of at most 100 bytes" in _refusal(path)


@pytest.mark.parametrize("name", [".", "/", "..", "nothing"])
def test_path_without_a_model__is_refused(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInputError):
        read_model(Path(name))


def test_pickle__is_never_loaded(path: Path, tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    data = pickle.dumps(PickleBomb(trace))
    for content in (
        data,
        _crafted({"__metadata__": {"manifest": repr(data)}}, b""),
        data[:8] + data,
    ):
        path.write_bytes(content)
        _refusal(path)
    assert not trace.exists()
    pickle.loads(data)
    assert trace.exists()  # it would have gone off


MANIFESTS = {
    "nothing": ("", "in its header"),
    "text": ("schema: 1\n", "in its header"),
    "torn": ('{"schema": 2, "kind": "va', "in its header"),
    "endless number": ("1" * 10_000, "in its header"),
    "deep lists": ("[" * 100_000, "in its header"),
    "deep objects": ('{"a":' * 100_000, "in its header"),
    "list": ("[1]", "of schema 2"),
    "null": ("null", "of schema 2"),
    "empty": ("{}", "of schema 2"),
}


@pytest.mark.parametrize("case", MANIFESTS)
def test_manifest__that_is_none_is_refused(path: Path, case: str) -> None:
    content, named = MANIFESTS[case]
    _put(path, content, path.read_bytes())
    assert named in _refusal(path)


WANTED = "a manifest with params, made, network, sha256"
FIELDS: list[tuple[str, Any, str]] = [
    ("schema", ..., "of schema 2"),
    ("schema", 1, "of schema 2"),
    ("schema", "2", "of schema 2"),
    ("kind", ..., "kind value or policy"),
    ("kind", "critic", "kind value or policy"),
    ("kind", ["value"], "kind value or policy"),
    ("kind", "policy", "a network from 99 to 99 values"),
    ("params", ..., WANTED),
    ("params", {}, "the constants of this version's robot"),
    ("params", {**dataclasses.asdict(PAPER), "x": 1}, "the constants of this version's robot"),
    ("params", {**dataclasses.asdict(PAPER), "l": -1}, "usable constants (l = -1"),
    ("params", {**dataclasses.asdict(PAPER), "n_joints": 4}, "usable constants (n_joints = 4"),
    ("params", {**dataclasses.asdict(PAPER), "n_joints": 8.0}, "usable constants (n_joints = 8.0"),
    ("params", {**dataclasses.asdict(PAPER), "n_joints": 10**9}, "usable constants (n_joints"),
    ("params", {**dataclasses.asdict(PAPER), "n_joints": 9}, "the rows of this version"),
    ("observation", ..., "the rows of this version's observation"),
    ("observation", [["phi", 99]], "the rows of this version's observation"),
    ("network", ..., WANTED),
    ("network", [], "a network from 99 to 1 values"),
    ("network", [99], "a network from 99 to 1 values"),
    ("network", "99, 1", WANTED),
    ("network", [99, 6.0, 5, 1], "a network from 99 to 1 values"),
    ("network", [99, True, 5, 1], "a network from 99 to 1 values"),
    ("network", [99, 0, 1], "a network from 99 to 1 values"),
    ("network", [99, -6, 5, 1], "a network from 99 to 1 values"),
    ("network", [98, 6, 5, 1], "a network from 99 to 1 values"),
    ("network", [99, 6, 5, 2], "a network from 99 to 1 values"),
    ("network", [99, 5, 6, 1], "tensors"),
    ("network", [99, 6, 1], "tensors"),
    ("network", [99, 6, 5, 1, 1], "tensors"),
    ("network", [99, 10**15, 1], "tensors"),  # would be petabytes
    ("network", [99, *[10**6] * 1000, 1], "tensors"),
    ("activation", "elu", "activation relu or tanh"),
    ("activation", ["relu"], "activation relu or tanh"),
    ("images", "no", "images canonical or both or given"),
    ("images", ["both"], "images canonical or both or given"),
    ("images", None, "images canonical or both or given"),
    ("sha256", ..., WANTED),
    ("sha256", 7, WANTED),
    ("sha256", "", "sha256 differs"),
    ("sha256", "0" * 64, "sha256 differs"),
    ("made", ..., WANTED),
    ("made", ["a"], WANTED),
]


@pytest.mark.parametrize(("name", "value", "expected"), FIELDS)
def test_manifest__with_a_bad_field_is_refused(
    path: Path, name: str, value: Any, expected: str
) -> None:
    assert observation_size(8) == 99
    _change(path, **{name: value})
    assert expected in _refusal(path)


def _tensors(path: Path, **changes: Any) -> bytes:
    """The model's tensors with some replaced; those that become ``...`` are left out."""
    fields = {**load(path.read_bytes()), **changes}
    return save({name: tensor for name, tensor in fields.items() if tensor is not ...})


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e38, -3e37])
@pytest.mark.parametrize("name", ["weight.1", "bias.0"])
def test_weights__that_are_not_finite_are_refused(path: Path, name: str, value: float) -> None:
    tensor = load(path.read_bytes())[name].copy()
    tensor.flat[-1] = value
    _retell(path, _tensors(path, **{name: tensor}))
    assert "finite float32 numbers" in _refusal(path)


@pytest.mark.parametrize("dtype", [np.float64, np.float16, np.int32, np.bool_])
def test_weights__of_another_type_are_refused(path: Path, dtype: Any) -> None:
    _retell(path, _tensors(path, **{"bias.1": np.zeros(5, dtype=dtype)}))
    assert "finite float32 numbers" in _refusal(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"weight.1": ...},
        {"bias.2": ...},
        {"weight.3": np.zeros((1, 1), dtype=np.float32)},
        {"weight.0": np.zeros((6, 99), dtype=np.float32)},
        {"bias.0": np.zeros((6, 1), dtype=np.float32)},
    ],
)
def test_weights__of_other_sizes_are_refused(path: Path, changes: dict[str, Any]) -> None:
    _retell(path, _tensors(path, **changes))
    assert "tensors of these shapes: {'weight.0': (99, 6), " in _refusal(path)


def _crafted(header: dict[str, Any], numbers: bytes) -> bytes:
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + numbers


@pytest.mark.parametrize("dtype", ["BF16", "F8_E5M2"])
def test_weights__of_a_type_that_numpy_lacks_are_refused(path: Path, dtype: str) -> None:
    size = 2 if dtype == "BF16" else 1
    header: dict[str, Any] = {}
    end = 0
    for name, tensor in load(path.read_bytes()).items():
        begin, end = end, end + size * tensor.size
        header[name] = {
            "dtype": dtype, "shape": tensor.shape, "data_offsets": [begin, end],
        }  # fmt: skip
    _retell(path, _crafted(header, bytes(end)))
    assert "safetensors file" in _refusal(path)


def test_header__that_lies_about_sizes_is_refused(path: Path) -> None:
    lies = [
        _crafted(
            {"x": {"dtype": "F32", "shape": [2**62, 2**62], "data_offsets": [0, 4]}}, bytes(4)
        ),
        _crafted(
            {"x": {"dtype": "F32", "shape": [10**12], "data_offsets": [0, 4 * 10**12]}}, bytes(4)
        ),
    ]
    for data in lies:
        _retell(path, data)
        assert "a safetensors file" in _refusal(path)
        write_model(path, _model())
    path.write_bytes(struct.pack("<Q", 2**63) + bytes(100))
    assert "a model with a manifest in its header" in _refusal(path)


def _damage(data: bytes, kind: str, place: float, byte: int) -> bytes:
    """A file with a byte changed, a stretch missing, or something put in or in its place."""
    at = int(place * (len(data) - 1))
    changed = bytes([data[at] ^ byte])
    return {
        "flipped": data[:at] + changed + data[at + 1 :],
        "cut": data[:at],
        "hole": data[:at] + data[at + byte :],
        "longer": data[:at] + bytes([byte]) * byte + data[at:],
        "swapped": data[at:] + data[:at],
    }[kind]


@settings(max_examples=300)
@given(
    st.sampled_from(["flipped", "cut", "hole", "longer", "swapped"]),
    st.floats(0.0, 1.0),
    st.integers(1, 255),
)
def test_damaged_file__is_refused_or_the_same_model(kind: str, place: float, byte: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "value.safetensors"
        write_model(path, _model())
        data = path.read_bytes()
        path.write_bytes(_damage(data, kind, place, byte))
        refused = True
        with contextlib.suppress(InvalidInputError):
            model = read_model(path)
            refused = False
        if refused:
            assert "\n" not in _refusal(path)
            return
        good = _model()  # a space in the header may be lost: what counts is the same
        assert (model.kind, model.params, model.made) == (good.kind, good.params, good.made)
        assert same_network(model.network, good.network)


@settings(max_examples=100)
@given(st.binary(max_size=200))
def test_bytes__that_anyone_made_up_are_refused(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.safetensors"
        path.write_bytes(data)
        with pytest.raises(InvalidInputError, match=r"^model = "):
            read_model(path)
