"""Checkpoints: all that continues after a segment, with a digest that any damage changes."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

import torch

from harness.files import FileError, read_bytes
from snake_env.errors import InvalidInputError, as_integer
from snake_env.system.files import write_atomically

_MAGIC = b"snake-mode-env checkpoint 1\n"
_DIGEST = 32  # bytes
_LARGEST = 16 * 2**30  # bytes: replay buffers are large


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Saves a state of tensors, numbers and texts, atomically."""
    file = io.BytesIO()
    torch.save(state, file)
    content = file.getvalue()
    write_atomically(path, _MAGIC + hashlib.sha256(content).digest() + content)


def load_checkpoint(path: Path, run: str, device: Any) -> dict[str, Any]:
    """The state in a file.

    Args:
        path: The file.
        run: Digest of the run that it must be of.
        device: Where its tensors go.

    Raises:
        InvalidInputError: It is damaged, or of another run.
    """
    try:
        content = read_bytes(path, _LARGEST)
    except FileError as error:
        raise bad_checkpoint(path, f"a file that can be read ({error})") from None
    start = len(_MAGIC) + _DIGEST
    digest, content = content[:start], content[start:]
    if digest != _MAGIC + hashlib.sha256(content).digest():
        raise bad_checkpoint(path, "an undamaged checkpoint (its digest differs)")
    try:
        state = torch.load(io.BytesIO(content), weights_only=True, map_location=device)
    except Exception as error:  # torch raises many kinds where the content is foreign
        raise bad_checkpoint(path, f"a checkpoint of train ({type(error).__name__})") from None
    if not isinstance(state, dict) or state.get("run") != run:
        raise bad_checkpoint(path, "a checkpoint of this run")
    return state


def bad_checkpoint(path: Path, expected: str) -> InvalidInputError:
    """An error about a checkpoint; with --overwrite a run does without it."""
    return InvalidInputError("checkpoint", str(path), f"{expected} (or --overwrite)")


def check_counters(
    path: Path, state: dict[str, Any], total: int, segment: int, iteration: int
) -> None:
    """Raises InvalidInputError unless a run can have come so far.

    Args:
        path: The checkpoint's file.
        state: Its state, with ``segment``, ``num_timesteps`` and ``n_updates``.
        total: Decisions in the whole run.
        segment: Decisions in a segment at least, but for the last one.
        iteration: Decisions in an iteration; segments end with whole ones.
    """
    names = ("segment", "num_timesteps", "n_updates")
    segments, decisions, updates = (as_integer(state.get(name)) for name in names)
    if (
        segments is None
        or decisions is None
        or updates is None
        or updates < 0
        or not 0 < segments <= -(-total // segment)
        or not min(segments * segment, total) <= decisions < total + iteration
        or decisions >= segments * (segment + iteration)
    ):
        counters = ", ".join(f"{name} {state.get(name)!r}" for name in names)
        raise bad_checkpoint(path, f"plausible counters, not {counters}")
