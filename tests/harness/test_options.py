"""Options: how their help is printed."""

from dataclasses import dataclass, field
from itertools import pairwise

import pytest

from harness.options import parse
from snake_env.errors import InvalidInputError

INDENT = 10 * " "
"""What a help's second line begins with."""


@dataclass(frozen=True)
class Inner:
    """A group."""

    depth: int = 3
    """A text that is long enough to stand on two lines of the source, and therefore has a break in
    it (which the terminal knows nothing of), and a second one before this last part of the sentence,
    - as it were."""


@dataclass(frozen=True)
class Outer:
    """A command."""

    inner: Inner = field(default_factory=Inner)
    width: str = "wide"
    """Another text that was broken where the source was full, long before the terminal's own last
    column, or after it."""


@pytest.mark.parametrize("width", [60, 80, 120])
def test_help__is_broken_by_the_terminal_and_not_by_the_source(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    with pytest.raises(SystemExit):
        parse(Outer, "command", ["--help"])
    printed = capsys.readouterr().out.splitlines()
    text = " ".join(" ".join(printed).split())
    assert "source, and therefore has a break in it (which the terminal" in text
    assert "sentence, - as it were. (default: 3)" in text
    assert "own last column, or after it. (default: wide)" in text
    for line, after in pairwise(printed):
        if line.startswith(INDENT) and after.startswith(INDENT) and after.strip():
            assert len(line.rstrip()) + len(after.split()[0]) + 2 >= width - 1, (line, after)


@pytest.mark.parametrize("word", ["a\udcff", "--width=\udc80"])
def test_word_that_is_no_text__is_refused(word: str) -> None:
    with pytest.raises(InvalidInputError, match=r"^argument = .*: expected text in UTF-8$"):
        parse(Outer, "command", [word])
