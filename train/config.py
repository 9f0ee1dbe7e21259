"""Options from three sources: the defaults, then a YAML file, then the command line."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import re
import types
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import tyro
import yaml

from harness.files import FileError, read_text
from harness.options import parse
from snake_env.errors import InvalidInputError, UnknownNameError

T = TypeVar("T")

_FLAG = "--config"
_HELP = (
    "--config FILE.yaml: options from a file, under the names below with underscores, or a recipe's "
    "file; the command line overrides it."
)
_LARGEST = 2**20  # bytes of a file
_KINDS = {bool: "true or false", int: "an integer", float: "a finite number", str: "a string"}


def parse_with_file(options: type[T], command: str, args: Sequence[str]) -> T:
    """Options of a command; ``--config FILE.yaml`` among the arguments changes the defaults.

    The file's keys are the names of the flags, with underscores. A recipe's file holds such a mapping
    for each stage: the command's own counts.

    Args:
        options: The command's options.
        command: Its name.
        args: Its arguments.

    Raises:
        SnakeEnvError: The file can't be used, or an option.
    """
    words, files = _split(args)
    prog = f"python -m train {command}"
    if not files:
        return parse(options, prog, words, about=_HELP)
    if len(files) > 1:
        raise InvalidInputError("config", files, "one file")
    given = read_yaml(Path(files[0]))
    if isinstance(given.get(command), dict):
        given = given[command]
    required = {
        field.name: tyro.MISSING
        for field in dataclasses.fields(options)  # type: ignore[arg-type]
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    }
    default = replaced(options(**required), given)
    parsed: T = parse(options, prog, words, default, about=_HELP)
    return parsed


def replaced(options: T, given: Mapping[str, Any]) -> T:
    """Options with some values replaced, by name.

    Raises:
        SnakeEnvError: There is no such option, or its value has the wrong type.
    """
    changed, used = _replace(options, given)
    unknown = sorted(set(given) - used)
    if unknown:
        raise UnknownNameError("option in the config", unknown[0], _names(changed))
    result: T = changed
    return result


def _split(args: Sequence[str]) -> tuple[list[str], list[str]]:
    """The arguments without ``--config``, and the files that it named."""
    words, files = [], []
    rest = iter(args)
    for word in rest:
        flag, equals, file = word.partition("=")
        if flag != _FLAG:
            words.append(word)
            continue
        file = file if equals else next(rest, "")
        if not file:
            raise InvalidInputError("config", file, "a YAML file")
        files.append(file)
    return words, files


_INT, _FLOAT, _MERGE = (f"tag:yaml.org,2002:{name}" for name in ("int", "float", "merge"))


class _Loader(yaml.SafeLoader):
    """Plain values only, and each key once.

    What an alias stands for could grow without bound. Numbers are decimal: to YAML 1.1, ``010`` is 8
    and ``1:30`` is 90.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, form) for tag, form in known if tag not in (_INT, _FLOAT, _MERGE)]
        for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases are not read")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        mapping = super().construct_mapping(node, deep)
        names = [key.value for key, _ in node.value]
        if not all(isinstance(key, str) for key in mapping):
            raise yaml.YAMLError("a mapping of options has texts for names")
        for name, times in Counter(names).items():
            if times > 1:
                raise yaml.YAMLError(f"duplicate key {name!r}")
        return mapping


_Loader.add_implicit_resolver(_INT, re.compile(r"[-+]?(0|[1-9][0-9]*)$"), list("-+0123456789"))
_Loader.add_implicit_resolver(
    _FLOAT,
    re.compile(
        r"[-+]?(\.[0-9]+|(0|[1-9][0-9]*)(\.[0-9]*)?)([eE][-+]?[0-9]+)?$|[-+]?\.inf$|\.nan$", re.I
    ),
    list("-+.0123456789"),
)


def read_yaml(path: Path) -> dict[str, Any]:
    """A mapping of names to values.

    Raises:
        InvalidInputError: The file is none, or holds something else.
    """
    try:
        content = yaml.load(read_text(path, _LARGEST), _Loader)
    except FileError as error:
        raise InvalidInputError("config", str(path), f"a file ({error})") from None
    except (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError) as error:
        expected = f"a YAML file ({error})"  # PyYAML's own errors, and those of dates and numbers
        raise InvalidInputError("config", str(path), expected) from None
    except RecursionError:
        expected = "a YAML file that is not nested too deeply"
        raise InvalidInputError("config", str(path), expected) from None
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
    hints = get_type_hints(type(options))
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if dataclasses.is_dataclass(value):
            changes[field.name], more = _replace(value, given)
            used |= more
        elif field.name in given:
            changes[field.name] = _converted(field.name, given[field.name], hints[field.name])
            used.add(field.name)
    return dataclasses.replace(options, **changes), used


def _converted(name: str, given: Any, wanted: Any) -> Any:
    """A value from the file as an option of a type.

    Raises:
        InvalidInputError: It is none.
    """
    origin, arguments = get_origin(wanted), get_args(wanted)
    if origin in (Union, types.UnionType):
        if given is None and types.NoneType in arguments:
            return None
        (wanted,) = (each for each in arguments if each is not types.NoneType)
        return _converted(name, given, wanted)
    if origin is Annotated:
        return _converted(name, given, arguments[0])
    if origin is Literal:
        if given not in arguments:
            raise UnknownNameError(name, str(given), map(str, arguments))
        return given
    if origin is tuple:
        each = arguments[0]
        if not isinstance(given, list):
            raise InvalidInputError(name, given, f"a list, each {_kind(each)}")
        return tuple(_converted(f"{name}[{k}]", value, each) for k, value in enumerate(given))
    return _plain(name, given, wanted)


def _plain(name: str, given: Any, wanted: Any) -> Any:
    if wanted is float and type(given) is int:
        with contextlib.suppress(ValueError, OverflowError):
            given = float(given)
    if wanted is Path and type(given) is str and "\0" not in given:
        return Path(given)
    if type(given) is not wanted or (wanted is float and not math.isfinite(given)):
        raise InvalidInputError(name, given, _kind(wanted))
    return given


def _kind(wanted: Any) -> str:
    return _KINDS.get(wanted, "a path")
