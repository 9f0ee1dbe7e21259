"""Files: the old one or the whole new one, whatever happens."""

import subprocess
import sys
from pathlib import Path

import pytest

from snake_env.system.files import is_stray, write_atomically
from tests.support import ROOT
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


@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_files__have_the_rights_of_any_new_file(tmp_path: Path, umask: int) -> None:
    script = "import sys, pathlib; from snake_env.system.files import write_atomically as write; "
    script += "folder = pathlib.Path(sys.argv[1]); write(folder / 'a', 'x'); (folder / 'b').touch()"
    words = [
        "sh",
        "-c",
        f'umask {umask:o}; "$@"',
        "sh",
        sys.executable,
        "-c",
        script,
        str(tmp_path),
    ]
    subprocess.run(words, cwd=ROOT, check=True)
    one, other = ((tmp_path / name).stat().st_mode for name in "ab")
    assert one == other == 0o100666 & ~umask


@pytest.mark.parametrize("name", [".snake-env-abcd123_.tmp"])
def test_strays__are_known(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    assert is_stray(tmp_path / name)
    assert not is_stray(tmp_path / "tmp.safetensors")
