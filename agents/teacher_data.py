"""Teacher data on disk: a folder of shards, each a file of its own."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from agents.teacher import STATE_FIELDS, Decisions
from snake_env.errors import InvalidInputError
from snake_env.modes import mode_table
from snake_env.state import StateBatch

SCHEMA = 1
MANIFEST = "teacher.json"
_ARRAYS = ("mask", "feasible", "cost_to_go")
_BAD_ZIP = (zipfile.BadZipFile, zlib.error, RuntimeError)


def shard_path(folder: Path, part: int) -> Path:
    """The file of a shard."""
    return folder / f"shard-{part:05d}.npz"


def to_bytes(decisions: Decisions) -> bytes:
    """A shard as an ``.npz`` file: the fields of :class:`StateBatch` and of :class:`Decisions`."""
    arrays = {name: getattr(decisions.states, name) for name in STATE_FIELDS}
    arrays |= {name: getattr(decisions, name) for name in _ARRAYS}
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def read_shard(path: Path) -> Decisions:
    """A shard; nothing in it is executed.

    Raises:
        InvalidInputError: The file is damaged.
    """
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name]) for name in (*STATE_FIELDS, *_ARRAYS)}
        _check(arrays)
    except (OSError, ValueError, TypeError, KeyError, EOFError, MemoryError, *_BAD_ZIP) as error:
        expected = f"a whole shard ({error}); without the file, collect makes it again"
        raise InvalidInputError("shard", str(path), expected) from None
    states = StateBatch(**{name: arrays[name] for name in STATE_FIELDS})
    return Decisions(states, *(arrays[name] for name in _ARRAYS))


def _check(arrays: dict[str, Any]) -> None:
    """Raises ValueError unless arrays have the types and shapes of a shard's."""
    count, n = np.shape(arrays["phi"])
    modes = len(mode_table(n))
    shapes = {"w": (3,), "phi": (n,), "target": (n,), **dict.fromkeys(_ARRAYS, (modes,))}
    kinds = {"phase": "i", "last_mode": "i", "mask": "b", "feasible": "b"}
    for name, array in arrays.items():
        shape, kind = (count, *shapes.get(name, ())), kinds.get(name, "f")
        if array.shape != shape or array.dtype.kind != kind:
            raise ValueError(f"{name} is {array.dtype} {array.shape}")


def read_manifest(folder: Path) -> dict[str, Any]:
    """What a folder's shards are.

    Raises:
        InvalidInputError: The folder holds no teacher data of this version.
    """
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise InvalidInputError("data", str(folder), "a folder of teacher data") from None
    if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
        raise InvalidInputError("data", str(folder), f"teacher data of schema {SCHEMA}")
    return manifest


def shards(folder: Path) -> Iterator[Decisions]:
    """All shards of a folder, in their order.

    Raises:
        InvalidInputError: The folder holds no teacher data, or a shard is damaged.
    """
    read_manifest(folder)
    for path in sorted(folder.glob("shard-*.npz")):
        yield read_shard(path)
