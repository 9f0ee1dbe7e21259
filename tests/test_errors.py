"""Error texts: one short line, whatever the value, and nothing in it that a terminal obeys."""

import unicodedata
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from snake_env.errors import InvalidInputError, UnknownNameError, printable


def _bomb() -> Any:
    """A list that is nine copies of a list, and so on: 10^60 numbers to print."""
    value: Any = [1] * 9
    for _ in range(60):
        value = [value] * 9
    return value


def _endless() -> Any:
    value: Any = []
    value.append(value)
    return value


ODD = {
    "a bomb": _bomb(),
    "a list that holds itself": _endless(),
    "a long text": "a" * 10**7,
    "a number of 10,000 digits": 10**10_000,
    "many numbers": list(range(10**6)),
    "a large array": np.zeros((1000, 1000)),
    "nested dicts": {"a": {"b": {"c": {"d": {"e": {}}}}}},
    "escapes": "\x1b[31mred\x1b]0;title\x07\n\r",
    "half a pair": "\udcff",
    "text that runs backwards": "\u202eabc",
}


@pytest.mark.parametrize("value", ODD.values(), ids=ODD.keys())
def test_error__is_a_short_line_whatever_the_value(value: Any) -> None:
    for error in (
        InvalidInputError("field", value, "something else"),
        UnknownNameError("policy", value, ["ppo"]),
    ):
        assert len(str(error)) < 200
        assert str(error).encode()
        assert printable(str(error)) == str(error)


def test_error__keeps_both_ends_of_a_long_value() -> None:
    path = "/a/" + "long/" * 100 + "file.npz"
    text = str(InvalidInputError("tasks", path, "a file"))
    assert text.startswith("tasks = '/a/long/")
    assert "file.npz': expected a file" in text


@given(st.text())
def test_printable__leaves_nothing_to_obey(text: str) -> None:
    shown = printable(text)
    assert not {unicodedata.category(char) for char in shown} & {"Cc", "Cf", "Cs", "Zl", "Zp"}
    assert printable(shown) == shown


@pytest.mark.parametrize("text", ["99.6\u00a0%", "naïve", "π [rad] [/red]", "a\\b"])
def test_printable__leaves_ordinary_text_alone(text: str) -> None:
    assert printable(text) == " ".join(text.split())
