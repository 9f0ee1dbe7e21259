"""README.md and the documentation: what they print runs, their links lead on, their tables are true."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import inspect
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import pytest

from evaluate.compare import CompareOptions
from evaluate.options import Options as EvaluateOptions
from evaluate.solve import SolveOptions
from harness.options import parse
from snake_env import ModeTable
from snake_env.__main__ import _parser
from snake_env.envs import SnakeModeSelectionEnv
from snake_env.envs.reward import RewardWeights
from snake_env.params import N_JOINTS_RANGE, PRESETS, SnakeParams
from snake_env.policies.registry import LEARNED, POLICIES
from snake_env.policies.value import shipped
from snake_env.sim.masks import MaskLevel
from snake_env.sim.tasks import FROZEN
from tests.support import ROOT
from train.__main__ import COMMANDS
from train.config import parse_with_file
from train.models import SOURCES

DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS.glob("*.md")])
LONG = {"CHANGELOG.md", "deviations.md", "lab-notes.md", "results.md"}
"""Pages whose words and sentences are not measured here."""
_HISTORY = {"lab-notes.md"}  # commands of old revisions
_BLOCK = re.compile(r"(<!-- not run: [^>]+-->\n)?^```(\w+)[^\n]*\n(.*?)^```", re.S | re.M)
_COMMAND = re.compile(r"python -m (train|evaluate|snake_env)\b")
_DROPPED = (
    *("shall", "someone must", "anew", "stands in", "the former", "the latter", "ever new", "told"),
    *("a look would have", "makes it dear", "so many runs", "a small network's word", "tells of"),
    *("goes on", "go on", "what comes of", "in the place of"),
)


def _text(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def _ids(page: Path) -> str:
    return page.name


def _blocks(page: Path, kind: str) -> Iterator[tuple[bool, str]]:
    """Code blocks of a kind: whether the page says that it is not run, and the code."""
    for skipped, language, code in _BLOCK.findall(_text(page)):
        if language == kind:
            yield bool(skipped), code


def _prose(page: Path) -> str:
    """A page without code, tables, headings and pictures; links are their words."""
    text = re.sub(r"^```.*?^```", "\n\n", _text(page), flags=re.S | re.M)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.S)
    text = re.sub(r"^(\||#|!|\[!).*$", "\n\n", text, flags=re.M)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return re.sub(r"^(\*|\d+\.) ", "\n\n", text, flags=re.M)


def _commands() -> Iterator[tuple[str, str]]:
    """Every command of a page, from its blocks and from its sentences."""
    for page in PAGES:
        if page.name in _HISTORY:
            continue
        for _, code in _blocks(page, "sh"):
            for line in code.replace("\\\n", " ").splitlines():
                yield page.name, " ".join(line.partition("  #")[0].split())
        outside = re.sub(r"^```.*?^```", "", _text(page), flags=re.S | re.M)
        for code in re.findall(r"`([^`]+)`", outside):
            yield page.name, " ".join(code.replace("\\|", "|").split())


def _parse(words: list[str]) -> Any:
    """A command's own parser takes its words."""
    module, *rest = words
    if module == "snake_env":
        return _parser().parse_args(rest)
    if module == "train":
        options = importlib.import_module(f"train.{rest[0]}").Options
        return parse_with_file(options, rest[0], rest[1:])
    for name, options in (("compare", CompareOptions), ("solve", SolveOptions)):
        if rest[:1] == [name]:
            return parse(options, name, rest[1:])
    return parse(EvaluateOptions, "python -m evaluate", rest)


def _is_shown_whole(command: str) -> bool:
    """Whether a command stands there with its arguments, and is not just named."""
    words = command.split()
    named = ("COMMAND", "...", "--help", "--version")
    return bool(_COMMAND.search(command)) and len(words) > 3 and not {*words} & {*named}


@pytest.mark.parametrize(
    ("page", "command"), sorted({each for each in _commands() if _is_shown_whole(each[1])})
)
def test_command__is_taken_by_its_parser(page: str, command: str, tmp_path: Path) -> None:
    (tmp_path / "my.yaml").write_text("timesteps: 1048576\n", encoding="utf-8")
    command = command.replace("my.yaml", str(tmp_path / "my.yaml"))
    words = shlex.split(re.split(r" [|>&]", command.partition("python -m ")[2])[0])
    options = _parse(words)
    if hasattr(options, "set"):
        preset = getattr(options, "preset", "paper")
        assert preset in PRESETS


def _pages_with(kind: str) -> list[Path]:
    """The pages with blocks of a kind that are to be run."""
    return [page for page in PAGES if not all(skipped for skipped, _ in _blocks(page, kind))]


@pytest.mark.parametrize("page", _pages_with("yaml"), ids=_ids)
def test_yaml__has_options_of_a_command(page: Path, tmp_path: Path) -> None:
    for _, code in _blocks(page, "yaml"):
        file = tmp_path / "my.yaml"
        file.write_text(code, encoding="utf-8")
        _parse(["train", "ppo", "--config", str(file)])


@pytest.mark.parametrize("page", _pages_with("python"), ids=_ids)
def test_snippets__run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one namespace a page, so that a later one may use what an earlier one has made."""
    codes = [code for skipped, code in _blocks(page, "python") if not skipped]
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(ROOT))
    namespace: dict[str, Any] = {"__name__": "__main__"}
    for code in codes:
        exec(compile(code, str(page), "exec"), namespace)
    assert len(namespace) > 2


def test_snippets__are_left_out_for_two_reasons_only() -> None:
    reasons = [
        reason
        for page in PAGES
        for reason in re.findall(r"<!-- not run: (.*?) -->\n```python", _text(page))
    ]
    assert len(reasons) <= 3, reasons
    for page in PAGES:
        for skipped, code in _blocks(page, "python"):
            compile(code, page.name, "exec")
            assert skipped == bool(re.search(r"runs/|sb3_contrib", code)), code


def _heads(file: Path) -> set[str]:
    """The anchors of a page."""
    text = re.sub(r"^```.*?^```", "", _text(file), flags=re.S | re.M)
    heads = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", head.lower())) for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=_ids)
def test_links__lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", _text(page), flags=re.S | re.M)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        if file.name == "environment.md":
            file = file.with_name("environment-head.md")  # the docstring follows
        assert file.exists(), target
        assert not anchor or anchor in _heads(file), target


def test_pages__are_all_in_the_navigation() -> None:
    config = _text(ROOT / "mkdocs.yml")
    named = set(re.findall(r": ([\w-]+\.md)$", config, re.M))
    there = {page.name for page in DOCS.glob("*.md")} - {"environment-head.md"} | {"environment.md"}
    assert named == there


@pytest.mark.parametrize("page", PAGES, ids=_ids)
def test_prose__is_plain(page: Path) -> None:
    prose = re.sub(r"`[^`]*`", "", _prose(page))
    tables = re.sub(r"`[^`]*`", "", "\n".join(re.findall(r"^\|.*$", _text(page), re.M)))
    for phrase in _DROPPED if page.name not in LONG else ():
        assert not re.search(rf"\b{phrase}\b", prose + tables, re.I), phrase


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=_ids)
def test_lines__are_short(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", _text(page), flags=re.S | re.M)
    for line in text.splitlines():
        assert len(line) <= 100 or line.startswith("|"), line


@pytest.mark.parametrize("page", [page for page in PAGES if page.name not in LONG], ids=_ids)
def test_sentences__are_short(page: Path) -> None:
    for sentence in re.split(r"(?<=[.:;?])\s|\n\n", _prose(page)):
        words = [word for word in sentence.split() if re.search(r"\w", word)]
        assert len(words) <= 25, sentence


def test_prose__names_no_registry() -> None:
    assert not [page.name for page in PAGES if re.search(r"pypi|npmjs|unpkg", _text(page), re.I)]


def test_readme__has_the_figures_of_the_results() -> None:
    robot, count = "", 0
    for head, policy, *cells in re.findall(
        r"^\| (.*?) \| `([\w+]+)`.*? \| ([\d.]+).% \| ([\d.]+) s \| ([\d.]+) \|$",
        _text(ROOT / "README.md").replace("| | ", "|  | "),
        re.M,
    ):
        robot = head.partition("`, ")[0].strip("` ") or robot
        data = json.loads(_text(DOCS / "data" / f"{robot}.json"))
        if head:
            assert head.endswith(f" {data['tasks']['n']:,} tasks")
        row = data["policies"][policy]
        figures = 100 * row["success_rate"], row["time_s"]["mean"], row["rollouts_per_decision"]
        assert cells == [f"{value:.{k}f}" for value, k in zip(figures, (2, 1, 1), strict=True)]
        count += 1
    assert count == 7


def test_results__are_short() -> None:
    prose = re.sub(r"^\|.*$", "", _text(DOCS / "results.md"), flags=re.M)
    assert len(prose.split()) <= 1500


def _module(name: str) -> ModuleType:
    """A module of docs/."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def hooks() -> ModuleType:
    return _module("hooks")


def _cells(table: str) -> list[list[str]]:
    return [[cell.strip() for cell in row.strip("| ").split(" | ")] for row in table.splitlines()]


def test_constants__are_all_on_the_page_of_robots(hooks: ModuleType) -> None:
    assert "<!-- constants -->" in _text(DOCS / "robots.md")
    table = hooks.on_page_markdown("<!-- constants -->")
    head, _, *rows = _cells(table)
    assert head[4:] == [f"`{name}`" for name in PRESETS]
    assert [row[0] for row in rows] == [f"`{f.name}`" for f in dataclasses.fields(SnakeParams)]
    by_name = {row[0].strip("`"): row for row in rows}
    assert by_name["dt"][2:6] == ["s", "sampling time", "0.02", "**0.2**"]
    assert by_name["epsilon_p"][1:3] == ["ε<sub>p</sub>", "rad"]
    assert by_name["n_joints"][4:] == ["8", "8", "8", "**6**", "**10**"]
    assert by_name["head_contact"][4:7] == ["yes", "yes", "**no**"]
    assert by_name["phi_limit"][4] == "π/2"
    assert by_name["gains"][5] == "**1,&nbsp;1,&nbsp;0.5,&nbsp;0.5**"
    for name, row in by_name.items():
        for preset, cell in zip(PRESETS, row[4:], strict=True):
            changed = getattr(SnakeParams.preset(preset), name) != getattr(SnakeParams(), name)
            assert cell.startswith("**") == changed


def test_modes__are_counted_on_the_page_of_robots(hooks: ModuleType) -> None:
    assert "<!-- modes -->" in _text(DOCS / "robots.md")
    joints, _, modes = _cells(hooks.modes_table())
    low, high = N_JOINTS_RANGE
    assert [int(n) for n in joints[1:]] == list(range(low, high + 1))
    assert [int(n.replace(",", "")) for n in modes[1:]] == [
        len(ModeTable(n).mask(1)) for n in range(low, high + 1)
    ]


def test_networks_that_ship__are_on_the_page_of_policies(hooks: ModuleType) -> None:
    assert "<!-- shipped -->" in _text(DOCS / "policies.md")
    head, _, *rows = _cells(hooks.shipped_table())
    assert [row[0].strip("`") for row in rows] == list(PRESETS)
    for column, name in enumerate(head[1:], 1):
        yes = sum(row[column] == "yes" for row in rows)
        assert yes == len({model.params for model in shipped(name.strip("`"))})


def test_robots_and_ids__are_on_their_pages() -> None:
    robots, environment = _text(DOCS / "robots.md"), _text(DOCS / "environment-head.md")
    assert all(f"`{name}`" in robots and f"`{name}`" in environment for name in PRESETS)
    ids = [name for name in gymnasium.registry if name.startswith("SnakeModeSelection")]
    assert len(ids) == len(PRESETS)
    assert all(f"`{name}`" in environment for name in ids)


def test_mask_levels__are_on_the_page_of_the_environment() -> None:
    text = _text(DOCS / "environment-head.md")
    levels = list(MaskLevel.__args__)  # type: ignore[attr-defined]
    assert re.findall(r"^\| `(\w+)`(?: \(default\))? \| (?:the|also)", text, re.M) == levels
    default = inspect.signature(SnakeModeSelectionEnv).parameters["mask_level"].default
    assert f"`{default}` (default)" in text


def test_policies__are_all_on_their_page() -> None:
    text = _text(DOCS / "policies.md")
    table = text.partition("| Name |")[2].partition("\n\n")[0]
    names = re.findall(r"^\| `([\w-]+)` \|", table, re.M)
    assert set(names) == {*POLICIES, "skid"}
    assert all(f"`{name}`" in text for name in LEARNED)


def test_suites__are_on_the_page_of_the_evaluation() -> None:
    text = _text(DOCS / "evaluation.md")
    assert all(f"`{name}`" in text for name in [*FROZEN, "sim-1"])


def test_train__is_shown_with_every_command_that_it_has() -> None:
    text = _text(DOCS / "training.md")
    assert all(f"python -m train {name} " in text for name in COMMANDS)
    words = {2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}
    assert f"{words[len(SOURCES)]} models" in text


def test_reward__is_what_the_pages_say() -> None:
    weights = RewardWeights()
    worst = weights.failure + weights.time * SnakeParams().horizon
    said = f"returns {weights.success:g} - {-weights.time:g} k, and every failure {worst:g}"
    for page in ("training.md", "faq.md"):
        assert said in " ".join(_text(DOCS / page).split())


def test_drawing__is_what_its_script_draws() -> None:
    drawing = _module("draw_robot").drawing()
    assert (DOCS / "images" / "robot.svg").read_text(encoding="utf-8") == drawing
