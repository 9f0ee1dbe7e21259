"""Files: the old one or the whole new one, whatever happens."""

from pathlib import Path

import pytest

from snake_env.system.files import write_atomically
from tests.support.commands import names


@pytest.mark.parametrize("content", ["new\n", b"new\n"])
def test_write_atomically__replaces_the_file_and_leaves_nothing_else(
    tmp_path: Path, content: str | bytes
) -> None:
    path = tmp_path / "file"
    path.write_text("old")
    with path.open() as reader:
        write_atomically(path, content)
        assert reader.read() == "old"  # whoever had it open still reads the old one
    assert path.read_bytes() == b"new\n"
    assert names(tmp_path) == {"file"}


def test_write_atomically__that_fails_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("old")
    with pytest.raises(UnicodeEncodeError):
        write_atomically(path, "new \ud800")
    assert path.read_text() == "old"
    assert names(tmp_path) == {"file"}
