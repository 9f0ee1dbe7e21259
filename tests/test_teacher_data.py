"""Teacher data on disk: what is written is read, and damaged shards are one clear error."""

import json
import pickle
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from agents.teacher import STATE_FIELDS, Decisions, judge
from agents.teacher_data import (
    MANIFEST,
    SCHEMA,
    read_manifest,
    read_shard,
    shard_path,
    shards,
    to_bytes,
)
from snake_env.errors import InvalidInputError
from snake_env.state import StateBatch
from tests.conftest import PAPER, random_state

ARRAYS = ("mask", "feasible", "cost_to_go")


def _decisions(count: int = 3, first: int = 0) -> Decisions:
    states = [random_state(seed, PAPER, 5) for seed in range(first, first + count)]
    return judge(StateBatch.stack(states), "lookahead", PAPER)


def _arrays(decisions: Decisions) -> dict[str, np.ndarray]:
    arrays = {name: getattr(decisions.states, name) for name in STATE_FIELDS}
    return arrays | {name: getattr(decisions, name) for name in ARRAYS}


def _assert_same(one: Decisions, other: Decisions) -> None:
    for name, array in _arrays(one).items():
        again = _arrays(other)[name]
        assert np.array_equal(array, again), name
        assert array.dtype == again.dtype, name


def _folder(path: Path, count: int = 3) -> Path:
    path.mkdir(parents=True)
    (path / MANIFEST).write_text(json.dumps({"schema": SCHEMA, "teacher": "lookahead"}))
    for part in reversed(range(count)):
        shard_path(path, part).write_bytes(to_bytes(_decisions(2 + part, 10 * part)))
    return path


def _refusal(path: Path) -> str:
    with pytest.raises(InvalidInputError) as caught:
        read_shard(path)
    assert (caught.value.field, caught.value.value) == ("shard", str(path))
    assert "\n" not in str(caught.value)
    assert "without the file, collect makes it again" in str(caught.value)
    return str(caught.value)


def test_shard__is_read_as_it_was_written(tmp_path: Path) -> None:
    decisions = _decisions(5)
    path = shard_path(tmp_path, 12)
    assert path == tmp_path / "shard-00012.npz"
    path.write_bytes(to_bytes(decisions))
    again = read_shard(path)
    _assert_same(again, decisions)
    assert len(again) == 5
    assert np.isinf(again.cost_to_go).any()
    judged = judge(again.states, "lookahead", PAPER)  # they are states like others
    _assert_same(judged, decisions)


def test_shard__is_the_same_file_at_any_time(monkeypatch: pytest.MonkeyPatch) -> None:
    one = to_bytes(_decisions())
    later = time.time() + 1e6
    monkeypatch.setattr(time, "time", lambda: later)
    assert to_bytes(_decisions()) == one


def test_folder__gives_its_shards_in_order(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "data", 12)
    (folder / "notes.txt").write_text("not a shard")
    read = list(shards(folder))
    assert [len(part) for part in read] == list(range(2, 14))
    for part, decisions in enumerate(read):
        _assert_same(decisions, _decisions(2 + part, 10 * part))


def _zipped(path: Path, content: bytes) -> bytes:
    with zipfile.ZipFile(path, "w") as file:
        for name in (*STATE_FIELDS, *ARRAYS):
            file.writestr(f"{name}.npy", content)
    return path.read_bytes()


def _saved(path: Path, **arrays: np.ndarray) -> bytes:
    np.savez(path, **arrays)
    return path.read_bytes()


def _npy(path: Path) -> bytes:
    np.save(path.with_suffix(".npy"), np.zeros(3))
    return path.with_suffix(".npy").read_bytes()


GOOD = to_bytes(_decisions())
HUGE = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (1%s, 8), }"
DAMAGES: dict[str, Callable[[Path], bytes]] = {
    "empty": lambda path: b"",
    "text": lambda path: b"phi, target\n",
    "garbage": lambda path: np.random.default_rng(0).bytes(5000),
    "pickle": lambda path: pickle.dumps(_arrays(_decisions())),
    "single array": _npy,
    "half": lambda path: GOOD[: len(GOOD) // 2],
    "without its end": lambda path: GOOD[:-1],
    "zeros inside": lambda path: GOOD[:900] + bytes(200) + GOOD[1100:],
    "not arrays": lambda path: _zipped(path, b"nothing of the kind"),
    "endless": lambda path: _zipped(path, (HUGE % (b"0" * 14)).ljust(127) + b"\n"),
    "other arrays": lambda path: _saved(path, phi0=np.zeros((3, 8))),
    "one missing": lambda path: _saved(
        path, **{name: array for name, array in _arrays(_decisions()).items() if name != "w"}
    ),
    "lengths": lambda path: _saved(path, **_arrays(_decisions()) | {"w": np.zeros((2, 3))}),
    "no length": lambda path: _saved(path, **_arrays(_decisions()) | {"phase": np.array(3)}),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_shard__is_one_clear_error(tmp_path: Path, damage: str) -> None:
    folder = _folder(tmp_path / "data")
    path = shard_path(folder, 1)
    path.write_bytes(DAMAGES[damage](path))
    _refusal(path)
    read = shards(folder)
    assert len(next(read)) == 2
    with pytest.raises(InvalidInputError) as caught:
        next(read)
    assert caught.value.value == str(path)


def test_missing_shard__is_one_clear_error(tmp_path: Path) -> None:
    assert "No such file" in _refusal(tmp_path / "shard-00001.npz")


def test_altered_byte__is_noticed_or_changes_nothing(tmp_path: Path) -> None:
    path, decisions, noticed = tmp_path / "shard-00000.npz", _decisions(), 0
    for place in range(0, len(GOOD), 7):
        path.write_bytes(GOOD[:place] + bytes([GOOD[place] ^ 0x55]) + GOOD[place + 1 :])
        try:
            again = read_shard(path)
        except InvalidInputError:
            noticed += 1
        else:
            _assert_same(again, decisions)
    assert noticed > len(GOOD) / 7 / 2


class _Bomb:
    """Leaves a trace where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., object], tuple[Path]]:
        return Path.touch, (self.path,)


def test_shard__is_never_unpickled(tmp_path: Path) -> None:
    trace, path = tmp_path / "trace", tmp_path / "shard-00000.npz"
    bombs = np.array([_Bomb(trace)] * 3, dtype=object)
    path.write_bytes(pickle.dumps(bombs))
    _refusal(path)
    np.savez(path, **_arrays(_decisions()) | {"elapsed": bombs})
    assert "allow_pickle=False" in _refusal(path)
    assert not trace.exists()
    with np.load(path, allow_pickle=True) as file:
        assert len(file["elapsed"]) == 3
    assert trace.exists()  # it would have gone off


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "a folder of teacher data"),
        (b"", "a folder of teacher data"),
        (b"\xff\xfe", "a folder of teacher data"),
        (b'{"schema": 1', "a folder of teacher data"),
        (b"[1]", "teacher data of schema 1"),
        (b"null", "teacher data of schema 1"),
        (b"{}", "teacher data of schema 1"),
        (b'{"schema": 2}', "teacher data of schema 1"),
        (b'{"schema": "1"}', "teacher data of schema 1"),
    ],
)
def test_folder__of_something_else_is_refused(
    tmp_path: Path, content: bytes | None, message: str
) -> None:
    folder = _folder(tmp_path / "data")
    (folder / MANIFEST).unlink()
    if content is not None:
        (folder / MANIFEST).write_bytes(content)
    for read in (read_manifest, lambda folder: next(shards(folder))):
        with pytest.raises(InvalidInputError, match=rf"^data = '.*data': expected {message}$"):
            read(folder)
    with pytest.raises(InvalidInputError, match="a folder of teacher data"):
        read_manifest(tmp_path / "missing")
