"""MkDocs hook: makes the page of the environment from its docstring."""

import inspect
import re
from typing import Any

from mkdocs.structure.files import File, Files

from snake_env.envs import SnakeModeSelectionEnv

_HEAD = """# The environment

![The robot reaches its target shape; the head does not move](images/sim-1.gif)

*Simulation 1 of the paper under its optimiser. Green wheels are on the ground, red ones lifted; the
green area is the support polygon, the crossed dot the centre of gravity, the blue ghost the target.
Joints near their limit turn amber, then red.*

| Id | Preset |
|---|---|
| `snake_env:SnakeModeSelection-v0` | `paper` |
| `snake_env:SnakeModeSelectionNarrow-v0` | `narrow`: link 0 does not touch the ground |
| `snake_env:SnakeModeSelectionHardware-v0` | `hardware`: the constants of section VI |

"""


def on_files(files: Files, config: Any) -> Files:
    """Adds ``environment.md``: the docstring, with Markdown's code marks and cross-references."""
    text = inspect.cleandoc(SnakeModeSelectionEnv.__doc__ or "")
    text = re.sub(r":\w+:`(?:[\w.]*\.)?(\w+)`", r"`\1`", text).replace("``", "`")
    files.append(File.generated(config, "environment.md", content=_HEAD + text + "\n"))
    return files
