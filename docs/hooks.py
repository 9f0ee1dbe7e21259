"""MkDocs hooks: the page of the environment from its docstring, and tables from the code."""

import dataclasses
import inspect
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import docstring_parser
from mkdocs.structure.files import File, Files

from snake_env.envs import SnakeModeSelectionEnv
from snake_env.modes import mode_table
from snake_env.params import N_JOINTS_RANGE, PRESETS, SnakeParams
from snake_env.policies.registry import LEARNED
from snake_env.policies.value import shipped

_HERE = Path(__file__).parent
_GREEK = {"Delta T": "ΔT", "theta": "θ", "epsilon": "ε", "phi": "φ", "eta": "η"}


def on_files(files: Files, config: Any) -> Files:
    """Adds ``environment.md``: the docstring, with Markdown's code marks and cross-references."""
    text = inspect.cleandoc(SnakeModeSelectionEnv.__doc__ or "")
    text = re.sub(r":\w+:`(?:[\w.]*\.)?(\w+)`", r"`\1`", text).replace("``", "`")
    head = (_HERE / "environment-head.md").read_text(encoding="utf-8")
    files.append(File.generated(config, "environment.md", content=head + text + "\n"))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Puts tables that are made from the code where a page asks for them."""
    for name, table in _TABLES.items():
        if f"<!-- {name} -->" in markdown:
            markdown = markdown.replace(f"<!-- {name} -->", table())
    return markdown


def on_page_content(html: str, **_: Any) -> str:
    """Sphinx's roles in docstrings become plain code, and no name is broken at a hyphen."""
    html = re.sub(r":\w+:\s*<code>(?:[\w.]*\.)?(\w+)</code>", r"<code>\1</code>", html)
    return re.sub(
        r"<code>([^<]+)</code>", lambda match: f"<code>{_unbroken(match[1])}</code>", html
    )


def _unbroken(code: str) -> str:
    """Code that is broken at spaces alone, and in words that fill a phone."""
    return re.sub(r"\S*-\S*", lambda word: _span(word[0]) if len(word[0]) < 40 else word[0], code)


def _span(word: str) -> str:
    return f'<span class="name">{word}</span>'


def constants_table() -> str:
    """Every field of ``SnakeParams``: symbol, unit, meaning, and its value in each preset."""
    heads = ["field", "symbol", "unit", "meaning", *(f"`{name}`" for name in PRESETS)]
    lines = [_row(heads), _row(["---"] * len(heads))]
    for name, symbol, unit, meaning in _fields():
        own = getattr(SnakeParams(), name)
        values = [getattr(SnakeParams.preset(preset), name) for preset in PRESETS]
        shown = [_shown(own), *(_shown(v) if v == own else f"**{_shown(v)}**" for v in values[1:])]
        lines.append(_row([f"`{name}`", symbol, unit, meaning, *shown]))
    return "\n".join(lines)


def modes_table() -> str:
    """How many modes robots have, in phase 1."""
    counts = range(N_JOINTS_RANGE[0], N_JOINTS_RANGE[1] + 1)
    modes = [f"{len(mode_table(n)):,}" for n in counts]
    rule = _row(["---"] * (len(modes) + 1))
    return "\n".join([_row(["`n_joints`", *map(str, counts)]), rule, _row(["modes", *modes])])


def shipped_table() -> str:
    """Which networks ship for which preset."""
    names = ("value", *LEARNED)
    lines = [_row(["robot", *(f"`{name}`" for name in names)]), _row(["---"] * (len(names) + 1))]
    robots = {name: [model.params for model in shipped(name)] for name in names}
    for preset in PRESETS:
        params = SnakeParams.preset(preset)
        lines.append(_row([f"`{preset}`", *("yes" if params in robots[n] else "-" for n in names)]))
    return "\n".join(lines)


def _fields() -> Iterator[tuple[str, str, str, str]]:
    """Each field's name, symbol, unit and meaning, from its docstring."""
    told = docstring_parser.parse_from_object(SnakeParams).params
    comments = {each.arg_name: (each.description or "").rstrip(".") for each in told}
    for field in dataclasses.fields(SnakeParams):
        parts = re.fullmatch(r"(?:(Delta T|[^\s:[]*) ?(?:\[(.*?)\])?: )?(.*)", comments[field.name])
        assert parts is not None, comments[field.name]
        symbol, unit, meaning = (_symbols(part or "") for part in parts.groups())
        yield field.name, symbol, unit.replace(" ", "&nbsp;"), meaning[:1].lower() + meaning[1:]


def _symbols(text: str) -> str:
    """Text whose symbols have Greek letters and subscripts."""
    for word, letter in _GREEK.items():
        text = re.sub(rf"(?<![a-z]){word}(?![a-z])", letter, text)
    return re.sub(r"\b(\w)_(\w+)", r"\1<sub>\2</sub>", text)


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _shown(value: Any) -> str:
    """A value, in fractions of pi where it is one."""
    if isinstance(value, tuple):
        return ",&nbsp;".join(map(_shown, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    for divisor in (1, 2, 4):
        if value == math.pi / divisor:
            return "π" if divisor == 1 else f"π/{divisor}"
    return f"{value:g}" if isinstance(value, float) else str(value)


_TABLES = {"constants": constants_table, "modes": modes_table, "shipped": shipped_table}
