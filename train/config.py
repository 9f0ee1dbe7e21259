"""Options from three sources: the defaults, then a YAML file, then the command line."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import yaml

from evaluate.options import parse
from snake_env.errors import InvalidInputError, UnknownNameError

T = TypeVar("T")

_FLAG = "--config"


def parse_with_file(options: type[T], prog: str, args: Sequence[str]) -> T:
    """Options of a command; ``--config FILE.yaml`` among the arguments changes the defaults.

    The file's keys are the names of the flags, with underscores.

    Raises:
        SnakeEnvError: The file can't be used, or an option.
    """
    words = list(args)
    given: dict[str, Any] = {}
    if _FLAG in words:
        at = words.index(_FLAG)
        if at + 1 == len(words):
            raise InvalidInputError("config", "", "a YAML file")
        given = _read(Path(words[at + 1]))
        del words[at : at + 2]
    if not given:
        return parse(options, prog, words)
    default, used = _replace(options(), given)
    unknown = sorted(set(given) - used)
    if unknown:
        raise UnknownNameError("option in the config", unknown[0], _names(default))
    return parse(options, prog, words, default)


def _read(path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InvalidInputError("config", str(path), f"a file ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise InvalidInputError("config", str(path), f"a YAML file ({reason})") from None
    if not isinstance(content, Mapping) or not all(isinstance(key, str) for key in content):
        raise InvalidInputError("config", str(path), "a mapping of options to values")
    return dict(content)


def _names(options: Any) -> list[str]:
    """Names of all options, those of groups among them."""
    names: list[str] = []
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        names += _names(value) if dataclasses.is_dataclass(value) else [field.name]
    return names


def _replace(options: Any, given: Mapping[str, Any]) -> tuple[Any, set[str]]:
    """The options with some values replaced, and the names of these."""
    changes: dict[str, Any] = {}
    used: set[str] = set()
    types = get_type_hints(type(options))
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if dataclasses.is_dataclass(value):
            changes[field.name], more = _replace(value, given)
            used |= more
        elif field.name in given:
            changes[field.name] = _converted(
                field.name, given[field.name], value, types[field.name]
            )
            used.add(field.name)
    return dataclasses.replace(options, **changes), used


def _converted(name: str, given: Any, default: Any, wanted: Any) -> Any:
    """A value from the file as the option wants it; a default of None stands for any type."""
    if isinstance(default, tuple) and isinstance(given, list):
        paths = get_args(wanted)[:1] == (Path,)
        return tuple(map(Path, given)) if paths else tuple(given)
    if isinstance(default, float) and type(given) is int:
        return float(given)
    if default is None:
        return Path(given) if isinstance(given, str) and Path in get_args(wanted) else given
    if type(given) is not type(default):
        raise InvalidInputError(name, given, f"a value of type {type(default).__name__}")
    return given
