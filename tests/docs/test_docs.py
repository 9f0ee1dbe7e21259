"""What README.md and the documentation print runs, and what they link to exists."""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from evaluate.compare import CompareOptions
from evaluate.options import Options as EvaluateOptions
from evaluate.solve import SolveOptions
from harness.options import parse
from snake_env.__main__ import _parser
from snake_env.envs.reward import RewardWeights
from snake_env.params import SnakeParams
from snake_env.policies.registry import POLICIES
from tests.support import ROOT
from train.__main__ import COMMANDS
from train.config import parse_with_file

PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")])
_BLOCK = re.compile(r"(<!-- not run[^>]*-->\n)?```(\w+)[^\n]*\n(.*?)```", re.S)
_HISTORY = {"lab-notes.md"}  # commands of old revisions
_DROPPED = (
    *("shall", "someone must", "anew", "stands in", "the former", "the latter", "ever new"),
    *("a look would have", "makes it dear", "so many runs", "a small network's word", "tells of"),
)


def _blocks(page: Path, kind: str) -> Iterator[tuple[bool, str]]:
    """Code blocks of a kind: whether the page says that it is not run, and the code."""
    for skipped, language, code in _BLOCK.findall(page.read_text(encoding="utf-8")):
        if language == kind:
            yield bool(skipped), code


def _commands() -> Iterator[tuple[str, str]]:
    for page in PAGES:
        if page.name in _HISTORY:
            continue
        for _, code in _blocks(page, "sh"):
            for line in code.replace("\\\n", " ").splitlines():
                words = line.partition("  #")[0].strip()
                if re.search(r"python -m (train|evaluate|snake_env)\b", words):
                    yield page.name, words


def _parse(words: list[str]) -> Any:
    """A command's own parser takes its words."""
    module, *rest = words
    if module == "snake_env":
        return _parser().parse_args(rest)
    if module == "train":
        options = importlib.import_module(f"train.{rest[0]}").Options
        return parse_with_file(options, "python -m train", rest[1:])
    for name, options in (("compare", CompareOptions), ("solve", SolveOptions)):
        if rest[:1] == [name]:
            return parse(options, name, rest[1:])
    return parse(EvaluateOptions, "python -m evaluate", rest)


@pytest.mark.parametrize(("page", "command"), sorted(set(_commands())))
def test_command__is_taken_by_its_parser(page: str, command: str) -> None:
    words = shlex.split(command.partition("python -m ")[2].rstrip("&| "))
    if words[1:] in (["--version"], ["COMMAND", "--help"]):
        return
    _parse([word for word in words if word != "[options]"])


def test_train__is_shown_with_every_command_that_it_has() -> None:
    text = (ROOT / "docs" / "training.md").read_text(encoding="utf-8")
    assert all(f"`train {name}" in text or f"train {name} " in text for name in COMMANDS)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_snippets__run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one namespace a page, so that a later one may use what an earlier one has made."""
    codes = [code for skipped, code in _blocks(page, "python") if not skipped]
    if not codes:
        pytest.skip("no snippets")
    if "sb3_contrib" in "".join(codes) and importlib.util.find_spec("sb3_contrib") is None:
        codes = [code for code in codes if "sb3_contrib" not in code]
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(ROOT))
    if page.name == "evaluation.md":
        codes.insert(0, "import numpy as np\nfrom snake_env import ModeTable, predict\n")
    namespace: dict[str, Any] = {"__name__": "__main__"}
    for code in codes:
        exec(compile(code, str(page), "exec"), namespace)
    assert len(namespace) > 2


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links__lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    targets = re.findall(r"\]\(([^)\s]+)\)", text)
    for target in targets:
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        if file.name == "environment.md":
            continue  # made of the environment's docstring
        assert file.exists(), target
        if anchor:
            heads = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.M)
            slugs = {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}
            assert anchor in slugs, target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_prose__is_plain(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    prose = re.sub(r"```.*?```|`[^`]*`|^\|.*$", "", text, flags=re.S | re.M)
    for phrase in _DROPPED:
        assert not re.search(rf"\b{phrase}\b", prose, re.I), phrase


def test_readme__has_short_sentences_and_lines() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert all(len(line) <= 120 or line.startswith(("|", "[", "![")) for line in text.splitlines())
    prose = re.sub(r"```.*?```|^\|.*$|^#.*$|^!?\[.*$", "\n\n", text, flags=re.S | re.M)
    for sentence in re.split(r"(?<=[.:;?])\s|\n\n", prose):
        words = [word for word in sentence.split() if re.search(r"\w", word)]
        assert len(words) <= 32, sentence


def test_results__are_short() -> None:
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    prose = re.sub(r"^\|.*$", "", text, flags=re.M)
    assert len(prose.split()) <= 1500


def test_constants__are_all_on_the_page_of_robots() -> None:
    spec = importlib.util.spec_from_file_location("hooks", ROOT / "docs" / "hooks.py")
    assert spec is not None
    assert spec.loader is not None
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    table = hooks.constants_table()
    for name, value in vars(SnakeParams()).items():
        (line,) = [line for line in table.splitlines() if line.startswith(f"| `{name}` |")]
        if isinstance(value, float):
            assert f"| {value:.6g} |" in line
    assert "`hardware`: 0.2 |" in table
    assert "`six`: 6, `ten`: 10 |" in table


def test_policies__are_all_on_their_page() -> None:
    text = (ROOT / "docs" / "policies.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in text for name in [*POLICIES, "skid"])


def test_reward__is_what_the_pages_say() -> None:
    weights = RewardWeights()
    assert (weights.time, weights.success) == (-0.1, 1.0)
    worst = weights.failure + weights.time * SnakeParams().horizon
    for page in ("training.md", "faq.md"):
        text = " ".join((ROOT / "docs" / page).read_text(encoding="utf-8").split())
        assert (
            f"returns {weights.success:g} - {-weights.time:g} k, and every failure {worst:g}"
            in (text.replace("k and every", "k, and every"))
        )
    assert os.path.exists(ROOT / "docs" / "environment-head.md")
