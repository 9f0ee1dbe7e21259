"""Command-line options: dataclasses parsed by tyro, and ``NAME=VALUE`` assignments."""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import io
import re
import sys
from collections.abc import Sequence
from typing import Annotated, Any, TypeVar, get_type_hints

import docstring_parser
import tyro

from snake_env.errors import InvalidInputError, SnakeEnvError

Assignments = tyro.conf.UseAppendAction[
    Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE")]
]
"""An option that may be repeated, each time with one ``NAME=VALUE``."""

T = TypeVar("T")


def parse(
    options: type[T],
    prog: str,
    args: Sequence[str] | None = None,
    default: T | None = None,
    about: str = "",
) -> T:
    """Options from the command line; help goes to the terminal as tyro makes it.

    Args:
        options: A dataclass; the docstrings under its fields are their help.
        prog: The command's name.
        args: The command line; default: the process's own.
        default: Values of the options that are not given; default: the dataclass's own.
        about: What the help says beside the dataclass's docstring.

    Raises:
        OptionError: An option does not exist or its value has the wrong type.
        InvalidInputError: A word is no text.
    """
    for word in sys.argv[1:] if args is None else args:
        if any("\ud800" <= each <= "\udfff" for each in word):
            raise InvalidInputError("argument", word, "text in UTF-8")
    _join_lines(options)
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            parsed: T = tyro.cli(  # type: ignore[assignment]  # tyro knows of None too
                options,
                prog=prog,
                description="\n\n".join(filter(None, [inspect.getdoc(options), about])),
                args=args,
                default=default,
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
            )
            return parsed
    except SystemExit as leaving:
        if not leaving.code:
            raise
        plain = re.sub(r"\x1b\[[0-9;]*m", "", complaint.getvalue())
        lines = [line.strip("\u2502 ").strip() for line in plain.splitlines()]
        shown = [line for line in lines if line and line[0] not in "\u256d\u2570\u2500"]
        words = [line for line in shown if not line.startswith("For full helptext")]
        raise OptionError(" ".join(words) + f" (see {prog} --help)") from None


def _join_lines(options: Any) -> None:
    """Puts each option's help on one line: tyro keeps most line breaks of docstrings under fields."""
    helps = {
        each.arg_name: " ".join((each.description or "").split())
        for each in docstring_parser.parse_from_object(options).params
    }
    hints = get_type_hints(options)
    for each in dataclasses.fields(options):
        if dataclasses.is_dataclass(hints[each.name]):
            _join_lines(hints[each.name])
        elif each.name in helps:
            each.metadata = {**each.metadata, "help": helps[each.name]}  # type: ignore[assignment]


class OptionError(SnakeEnvError):
    """An option that does not exist, or whose value has the wrong type."""
