"""Model files: what is written is read, and nothing that was damaged, altered or made up is."""

import hashlib
import itertools
import json
import pickle
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load, save

from snake_env.errors import InvalidInputError
from snake_env.modes import mode_table
from snake_env.networks.model_file import Model, read_model, write_model
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.sim.observation import observation_size
from tests.support.robots import PAPER

MADE = {"command": "python -m train value", "generation": 3, "note": "\u00e9 and \u2028"}
SIZES = [observation_size(8), 6, 5, 1]


def _model(kind: str = "value", n_joints: int = 8, hidden: tuple[int, ...] = (6, 5)) -> Model:
    rng = np.random.default_rng(n_joints)
    outputs = 1 if kind == "value" else len(mode_table(n_joints))
    pairs = list(itertools.pairwise([observation_size(n_joints), *hidden, outputs]))
    network = Network(
        [rng.normal(size=pair).astype(np.float32) for pair in pairs],
        [rng.normal(size=pair[1]).astype(np.float32) for pair in pairs],
    )
    return Model(kind, n_joints, network, MADE)  # type: ignore[arg-type]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A good model of the kind ``value``."""
    path = tmp_path / "value.safetensors"
    write_model(path, _model())
    return path


def _manifest(path: Path) -> dict[str, Any]:
    return json.loads(path.with_suffix(".json").read_text())


def _change(path: Path, **changes: Any) -> None:
    """Replaces fields of the manifest; those that become ``...`` are left out."""
    fields = {**_manifest(path), **changes}
    kept = {key: value for key, value in fields.items() if value is not ...}
    path.with_suffix(".json").write_text(json.dumps(kept))


def _put(path: Path, data: bytes) -> None:
    """Replaces the tensors, and signs them."""
    path.write_bytes(data)
    _change(path, sha256=hashlib.sha256(data).hexdigest())


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
    assert (again.kind, again.n_joints, again.made) == (kind, n_joints, MADE)
    assert again.network.sizes == model.network.sizes
    for name in ("weights", "biases"):
        pairs = zip(getattr(again.network, name), getattr(model.network, name), strict=True)
        assert all(np.array_equal(one, other) for one, other in pairs)
    names = {"a.model.safetensors", "a.model.json"}
    assert {file.name for file in (tmp_path / "new").iterdir()} == names  # nothing is left over


def test_model__overwrites_another(path: Path) -> None:
    write_model(path, _model("policy", 5))
    assert read_model(path).kind == "policy"


def test_model__is_the_same_file_each_time(path: Path, tmp_path: Path) -> None:
    write_model(tmp_path / "again.safetensors", _model())
    for suffix in (".safetensors", ".json"):
        one, other = path.with_suffix(suffix), (tmp_path / "again").with_suffix(suffix)
        assert one.read_bytes() == other.read_bytes()


def test_model__survives_a_write_that_fails(path: Path) -> None:
    before = path.read_bytes(), path.with_suffix(".json").read_bytes()
    model = _model("policy", 5)
    with pytest.raises(TypeError):
        write_model(path, Model("policy", 5, model.network, {"path": path}))  # is not JSON
    assert (path.read_bytes(), path.with_suffix(".json").read_bytes()) == before


def test_manifest__tells_what_the_model_is(path: Path) -> None:
    manifest = _manifest(path)
    assert manifest["schema"] == 1
    assert (manifest["kind"], manifest["n_joints"], manifest["network"]) == ("value", 8, SIZES)
    assert sum(size for _, size in manifest["observation"]) == SIZES[0]
    assert manifest["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert manifest["made"] == MADE


def test_check__accepts_robots_of_as_many_joints_only() -> None:
    model = _model(n_joints=5)
    model.check(SnakeParams(n_joints=5), model.kind)
    with pytest.raises(InvalidInputError, match=r"^n_joints = 8: expected 5: the model's$"):
        model.check(PAPER, model.kind)


@pytest.mark.parametrize("place", [0, 3, 8, 60, -400, -1])
def test_altered_byte__is_noticed(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)
    assert "sha256 differs" in _refusal(path)


@pytest.mark.parametrize("length", [0, 1, 7, 8, 100, 2000, -4, -1])
def test_truncated_file__is_refused_signed_or_not(path: Path, length: int) -> None:
    data = path.read_bytes()[:length]
    path.write_bytes(data)
    assert "sha256 differs" in _refusal(path)
    _put(path, data)
    assert "a safetensors file" in _refusal(path)


def test_missing_file__is_named(path: Path) -> None:
    path.unlink()
    assert "No such file" in _refusal(path)
    path.mkdir()
    assert "Is a directory" in _refusal(path)


def test_missing_manifest__is_named(path: Path) -> None:
    path.with_suffix(".json").unlink()
    message = _refusal(path)
    assert "value.json" in message
    assert "the model's manifest (No such file" in message


@pytest.mark.parametrize("name", [".", "/", "..", "nothing"])
def test_path_without_a_model__is_refused(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInputError):
        read_model(Path(name))


class _Bomb:
    """Leaves a trace where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., object], tuple[Path]]:
        return Path.touch, (self.path,)


def test_pickle__is_never_loaded(path: Path, tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    data = pickle.dumps(_Bomb(trace))
    path.write_bytes(data)
    _refusal(path)
    _put(path, data)
    assert "a safetensors file" in _refusal(path)
    path.with_suffix(".json").write_bytes(data)
    assert "a manifest in JSON" in _refusal(path)
    assert not trace.exists()
    pickle.loads(data)
    assert trace.exists()  # it would have gone off


MANIFESTS = {
    "nothing": (b"", "in JSON"),
    "text": (b"schema: 1\n", "in JSON"),
    "torn": (b'{"schema": 1, "kind": "va', "in JSON"),
    "no text": (b"\xff\xfe\x00{}", "in JSON"),
    "endless number": (b"1" * 10_000, "in JSON"),
    "deep lists": (b"[" * 100_000, "in JSON"),
    "deep objects": (b'{"a":' * 100_000, "in JSON"),
    "list": (b"[1]", "of schema 1"),
    "null": (b"null", "of schema 1"),
    "empty": (b"{}", "of schema 1"),
}


@pytest.mark.parametrize("case", MANIFESTS)
def test_manifest__that_is_none_is_refused(path: Path, case: str) -> None:
    content, named = MANIFESTS[case]
    path.with_suffix(".json").write_bytes(content)
    assert named in _refusal(path)


FIELDS: list[tuple[str, Any, str]] = [
    ("schema", ..., "of schema 1"),
    ("schema", 2, "of schema 1"),
    ("schema", "1", "of schema 1"),
    ("kind", ..., "kind value or quick-value or policy"),
    ("kind", "critic", "kind value or quick-value or policy"),
    ("kind", ["value"], "kind value or quick-value or policy"),
    ("kind", "policy", "a network from 99 to 99 values"),
    ("n_joints", ..., "n_joints from 5 to 16"),
    ("n_joints", 4, "n_joints from 5 to 16"),
    ("n_joints", 10**9, "n_joints from 5 to 16"),
    ("n_joints", 8.0, "n_joints from 5 to 16"),
    ("n_joints", True, "n_joints from 5 to 16"),
    ("n_joints", 9, "the rows of this version's observation"),
    ("observation", ..., "the rows of this version's observation"),
    ("observation", [["phi", 99]], "the rows of this version's observation"),
    ("network", ..., "a network from 99 to 1 values"),
    ("network", [], "a network from 99 to 1 values"),
    ("network", [99], "a network from 99 to 1 values"),
    ("network", "99, 1", "a network from 99 to 1 values"),
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
    ("sha256", ..., "the fields sha256 and made"),
    ("sha256", 7, "the fields sha256 and made"),
    ("sha256", ["a"], "the fields sha256 and made"),
    ("sha256", "", "the sha256 differs"),
    ("sha256", "0" * 64, "the sha256 differs"),
    ("made", ..., "the fields sha256 and made"),
    ("made", ["a"], "the fields sha256 and made"),
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


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["weight.1", "bias.0"])
def test_weights__that_are_not_finite_are_refused(path: Path, name: str, value: float) -> None:
    tensor = load(path.read_bytes())[name].copy()
    tensor.flat[-1] = value
    _put(path, _tensors(path, **{name: tensor}))
    assert "finite float32 numbers" in _refusal(path)


@pytest.mark.parametrize("dtype", [np.float64, np.float16, np.int32, np.bool_])
def test_weights__of_another_type_are_refused(path: Path, dtype: Any) -> None:
    _put(path, _tensors(path, **{"bias.1": np.zeros(5, dtype=dtype)}))
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
    _put(path, _tensors(path, **changes))
    assert "the tensors {'weight.0': (99, 6), " in _refusal(path)


def _crafted(header: dict[str, Any], size: int) -> bytes:
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + bytes(size)


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
    _put(path, _crafted(header, end))
    assert "safetensors file" in _refusal(path)


def test_header__that_lies_about_sizes_is_refused(path: Path) -> None:
    lies = [
        _crafted({"x": {"dtype": "F32", "shape": [2**62, 2**62], "data_offsets": [0, 4]}}, 4),
        _crafted({"x": {"dtype": "F32", "shape": [10**12], "data_offsets": [0, 4 * 10**12]}}, 4),
        struct.pack("<Q", 2**63) + bytes(100),
    ]
    for data in lies:
        _put(path, data)
        assert "a safetensors file" in _refusal(path)
