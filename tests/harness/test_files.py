"""Files: read in bounds, refused where they are damaged, named safely."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.files import FileError, file_name, parsed_json, read_bytes, read_json

BAD_JSON = [
    "",
    "{",
    "NaN",
    "[1e999, Infinity]",
    "9" * 10_000,
    "[" * 10**6,
    '{"a": -Infinity}',
    "\0",
]


@pytest.mark.parametrize("text", BAD_JSON, ids=range(len(BAD_JSON)))
def test_bad_json__is_an_error_of_ours(text: str) -> None:
    with pytest.raises(FileError):
        parsed_json(text)


def test_read__keeps_its_bounds(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_bytes(path, 5) == b"12345"
    with pytest.raises(FileError, match="it has 5 bytes; at most 4 are read"):
        read_bytes(path, 4)
    for odd in (tmp_path, tmp_path / "none", path / "below", Path("a\0b"), tmp_path / ("a" * 300)):
        with pytest.raises(FileError):
            read_bytes(odd)
    with pytest.raises(FileError, match="not a regular file"):
        read_bytes(Path("/dev/zero"))
    path.write_bytes(b"\xff")
    with pytest.raises(FileError, match="UTF-8"):
        read_json(path)


NAMES = [
    *("ppo", "PPO", "ppo.safetensors", "PPO.safetensors", "lookahead:width=16", "a/b.safetensors"),
    *("a-b.safetensors", "a/b", "a-b", "a\\b", "module:factory", "module:Factory", "ppo+shield"),
    *("a" * 300, "a" * 299 + "b", "b" + "a" * 299, "é" * 200, "../../etc/passwd", "..", ".", "-"),
    *("/", "a\0b", "con", "a b", "\udcff", "x" * 60, "x" * 61, "runs/a/best", "runs/b/best"),
]


def test_file_names__are_safe_short_and_their_own() -> None:
    made = [file_name(name) for name in NAMES]
    assert len({name.casefold() for name in made}) == len(NAMES)
    for name in made:
        assert name.isascii()
        assert 0 < len(name) < 80
        assert not set(name) & set('/\\: \0*?"<>|')
        assert name.strip(".-") == name


@pytest.mark.parametrize("name", ["ppo", "analytic-14", "ppo+shield", "first-feasible", "random"])
def test_file_names__of_ordinary_policies_are_theirs(name: str) -> None:
    assert file_name(name) == name


@given(st.text(min_size=1), st.text(min_size=1))
def test_file_names__differ_where_names_do(one: str, other: str) -> None:
    assert (file_name(one) == file_name(other)) == (one == other)
