"""Many episodes in little memory: numbers and references in arrays instead of a dict each."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from evaluate.protocol import COLUMNS, Row
from snake_env.sim.episode import OUTCOMES, EpisodeSummary

_KINDS: dict[Any, type] = {"int": np.int64, "float": np.float64}  # texts are references
_READ: dict[Any, Any] = {"int": int, "float": float}
_PYTHON: dict[Any, Any] = {"int": int, "float": (float, int), "str": str}
_NOT_NEGATIVE = ("task", "intervals", "time_s", "phase", "rollouts", "slip_m", "slip_rad")
_TOO_LARGE = 2**62
_TYPES: dict[str, Any] = {field.name: field.type for field in dataclasses.fields(EpisodeSummary)}
_TYPES |= {"task": "int", "rollouts": "int", "slip_m": "float", "slip_rad": "float"}
_PACKED = np.dtype([(name, _KINDS.get(_TYPES.get(name), np.object_)) for name in COLUMNS])


def pack(rows: Iterable[Mapping[str, Any]]) -> NDArray[np.void]:
    """Rows as a structured array.

    Raises:
        ValueError: A row has other columns, or a value is not of its column's type.
    """
    packed = []
    for row in rows:
        _check(row)
        packed.append(tuple(row.values()))
    try:
        return np.array(packed, dtype=_PACKED)
    except OverflowError:
        raise ValueError("a number that is too large") from None


def parsed(texts: Mapping[str, str | None]) -> Row:
    """A row from the texts of a line of ``episodes.csv``.

    Raises:
        ValueError: It has other columns, or a text is none of its column's values.
    """
    if tuple(texts) != COLUMNS:
        raise ValueError(f"columns {_listed(texts)} instead of {_listed(COLUMNS)}")
    row: Row = {}
    for name, text in texts.items():
        if text is None:
            raise ValueError(f"no {name}")
        try:
            row[name] = _READ.get(_TYPES.get(name), str)(text)
            if isinstance(row[name], int):
                np.int64(row[name])
        except (ValueError, OverflowError):
            raise ValueError(f"{name} = {text!r}") from None
    _check(row)
    return row


def _check(row: Mapping[str, Any]) -> None:
    """Raises ValueError unless it is a row that an episode can have."""
    if tuple(row) != COLUMNS:
        raise ValueError(f"columns {_listed(row)} instead of {_listed(COLUMNS)}")
    for name, value in row.items():
        kind = _TYPES.get(name, "str")
        good = isinstance(value, _PYTHON[kind]) and not isinstance(value, bool)
        if not good or (name in _NOT_NEGATIVE and not 0 <= value < _TOO_LARGE):
            raise ValueError(f"{name} = {value!r}")
    if row["outcome"] not in OUTCOMES:
        raise ValueError(f"outcome = {row['outcome']!r}")
    if not all(word.isdecimal() and len(word) < 6 for word in row["modes"].split()):
        raise ValueError(f"modes = {row['modes']!r}")


def _listed(columns: Iterable[object]) -> str:
    return ", ".join(map(str, columns))


class Rows(Sequence[Row]):
    """Rows of ``episodes.csv``: each is a fresh dict, made when it is asked for.

    Args:
        packed: What :func:`pack` gave, in parts.
    """

    def __init__(self, packed: Sequence[NDArray[np.void]]) -> None:
        whole = np.concatenate(packed) if packed else np.empty(0, dtype=_PACKED)
        self._packed = whole[np.argsort(whole["task"], kind="stable")]

    def __len__(self) -> int:
        return len(self._packed)

    def __iter__(self) -> Iterator[Row]:
        for record in self._packed:
            yield dict(zip(COLUMNS, record.item(), strict=True))

    @overload
    def __getitem__(self, k: int) -> Row: ...

    @overload
    def __getitem__(self, k: slice) -> list[Row]: ...

    def __getitem__(self, k: int | slice) -> Row | list[Row]:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        return dict(zip(COLUMNS, self._packed[k].item(), strict=True))

    def column(self, name: str) -> NDArray[Any]:
        """One column, by task, shape (N,)."""
        return self._packed[name].copy()
