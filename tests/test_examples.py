"""The examples that need nothing but the development environment: each must learn, not only run."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest

from tests.support import ROOT
from tests.support.commands import python

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
STEPS = {"sb3_ppo": 16_000, "sb3_dqn": 8_000, "cleanrl_ppo": 16_000, "planning": 3}
NUMBER = r"(-?\d+(?:\.\d+)?)"


@pytest.mark.parametrize("name", STEPS)
def test_example__learns(name: str) -> None:
    done = python(f"examples/{name}.py", "--steps", STEPS[name], "--seed", 0)
    match = re.search(rf"mean (return|time) {NUMBER}(?: s)? -> {NUMBER}", done.stdout)
    assert match is not None, done.stdout
    before, after = float(match[2]), float(match[3])
    assert after > before if match[1] == "return" else after < before


def test_example__fails_where_nothing_was_learned() -> None:
    done = python("examples/cleanrl_ppo.py", "--steps", 1, code=1)
    assert "did not rise" in done.stderr


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example__names_itself_in_its_docstring(path: Path) -> None:
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    assert docstring is not None
    calls = f"python examples/{path.name} --steps ", f"--policy examples.{path.stem}:"
    assert any(call in docstring for call in calls)


def test_own_policy__is_evaluated_beside_the_others(tmp_path: Path) -> None:
    own = "examples.own_policy:Careful"
    words = f"random --policy {own} --policy {own}+shield --tasks random:30:1 --workers 2"
    done = python("-m", "evaluate", *words.split(), "--no-pictures", "--out", tmp_path)
    figures = json.loads((tmp_path / "summary.json").read_text())["policies"]
    careful, shielded = figures[own], figures[f"{own}+shield"]
    assert careful["success"] >= 28
    assert careful["decision_latency_us"]["p50"] > 0
    assert shielded["success"] == careful["success"]  # it chooses feasible modes anyway
    assert shielded["rollouts_per_decision"] == pytest.approx(careful["rollouts_per_decision"] + 1)
    assert "examples.own_policy:Careful solves" in done.stdout


def test_interop__every_library_has_versions_and_one_example() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    libraries = re.search(r"^INTEROP \?= (.*)$", makefile, re.MULTILINE)[1].split()
    assert libraries
    for library in libraries:
        pattern = library.replace("-", "_") + "_*.py"
        assert len(list((ROOT / "examples").glob(pattern))) == 1
        pins = (ROOT / f"requirements/interop-{library}.in").read_text(encoding="utf-8")
        assert "torch==" in pins
