"""Files that anybody may have damaged or made up."""

from collections.abc import Callable
from pathlib import Path

from hypothesis import strategies as st


def damaged(content: bytes, data: st.DataObject) -> bytes:
    """The content with some bytes removed, put in or changed."""
    changed = bytearray(content)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(changed)))
        changed[at : at + data.draw(st.integers(0, 9))] = data.draw(st.binary(max_size=9))
    return bytes(changed)


class PickleBomb:
    """Leaves a trace where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., object], tuple[Path]]:
        return Path.touch, (self.path,)
