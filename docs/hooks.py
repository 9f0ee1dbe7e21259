"""MkDocs hooks: the page of the environment from its docstring, the constants from their source."""

import dataclasses
import inspect
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from snake_env.envs import SnakeModeSelectionEnv
from snake_env.params import PRESETS, SnakeParams

_HERE = Path(__file__).parent
_CONSTANTS = "<!-- constants -->"


def on_files(files: Files, config: Any) -> Files:
    """Adds ``environment.md``: the docstring, with Markdown's code marks and cross-references."""
    text = inspect.cleandoc(SnakeModeSelectionEnv.__doc__ or "")
    text = re.sub(r":\w+:`(?:[\w.]*\.)?(\w+)`", r"`\1`", text).replace("``", "`")
    head = (_HERE / "environment-head.md").read_text(encoding="utf-8")
    files.append(File.generated(config, "environment.md", content=head + text + "\n"))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Puts the table of constants where a page asks for it."""
    return markdown.replace(_CONSTANTS, constants_table())


def on_page_content(html: str, **_: Any) -> str:
    """Sphinx's roles in docstrings become plain code, without the path to a name."""
    return re.sub(r":\w+:\s*<code>(?:[\w.]*\.)?(\w+)</code>", r"<code>\1</code>", html)


def constants_table() -> str:
    """Every field of ``SnakeParams``: meaning, value in ``paper``, and what other presets change."""
    comments = dict(
        re.findall(
            r"^    (\w+): .*?  # (.*?)(?:  # noqa.*)?$", inspect.getsource(SnakeParams), re.M
        )
    )
    lines = ["| field | symbol, unit and meaning | `paper` | other presets |", "|---|---|---|---|"]
    for field in dataclasses.fields(SnakeParams):
        changed = ", ".join(
            f"`{preset}`: {_shown(changes[field.name])}"
            for preset, changes in PRESETS.items()
            if field.name in changes
        )
        meaning = comments[field.name].replace("|", "\\|")
        lines.append(f"| `{field.name}` | {meaning} | {_shown(field.default)} | {changed} |")
    return "\n".join(lines)


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_shown, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)
