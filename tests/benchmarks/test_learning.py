"""Learning curves of the results: what recipes' folders say, and nothing else."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks import learning, results
from benchmarks.learning import collect, collect_scratch, collect_seed
from evaluate.statistics import wilson95
from snake_env.errors import InvalidInputError
from train.recipe import ORDER

RECIPES = {"six": {"student": "0a1b"}}
FINAL = {name: {"success": 30 + k, "n": 50} for k, name in enumerate(["analytic", "ppo", "dqn"])}


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    """The folder of a finished recipe, as far as it is read."""
    folder = tmp_path / "recipe"
    files: dict[str, Any] = {
        "run.json": {
            "schema": 1,
            "algorithm": "recipe-full",
            "robot": "six",
            "command": "python -m train recipe",
            "git": "0123",
            "versions": {},
            "config": {
                "params": {"n_joints": 6},
                "seed": 3,
                "stages": {"ppo": {"validation_tasks": 40}},
            },
        },
        "ppo/run.json": {
            "schema": 1,
            "algorithm": "ppo",
            "robot": "six",
            "command": "python -m train ppo",
            "git": "0123",
            "versions": {},
            "config": {"params": {"n_joints": 6}, "seed": 3, "init": "0a1b"},
        },
        "log.csv": "step,minutes\n" + "".join(f"{k},{k}.5\n" for k in range(1, 1 + len(ORDER))),
        "imitate/log.csv": "round,raw_success,critic_success\n1,0.1,0.2\n2,0.5,0.6\n",
        "ppo/log.csv": (
            "timesteps,raw_success,critic_success\n1000,,\n2000000,0.7,0.8\n4000000,0.75,0.9\n"
        ),
        "dqn/log.csv": "timesteps,raw_success,critic_success\n500000,0.55,0.65\n",
        "models/validation.json": FINAL,
    }
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content if isinstance(content, str) else json.dumps(content))
    return folder


def test_figures__are_those_of_the_folder(recipe: Path) -> None:
    assert collect(recipe, ["six"]) == {
        "robot": "six",
        "command": "python -m train recipe",
        "git": "0123",
        "seed": 3,
        "student": "0a1b",
        "minutes": dict(zip(map(", ".join, ORDER), [1.5, 2.5, 3.5, 4.5], strict=True)),
        "final": FINAL,
        "count": 40,
        "curves": {
            "ppo": [[0.0, 0.5, 0.6], [2.0, 0.7, 0.8], [4.0, 0.75, 0.9]],
            "dqn": [[0.0, 0.5, 0.6], [0.5, 0.55, 0.65]],
        },
    }
    with pytest.raises(
        InvalidInputError, match=r"recipe-full of six'?: expected recipes .* of ten"
    ):
        collect(recipe, ["ten"])
    about = json.loads((recipe / "run.json").read_text())
    (recipe / "run.json").write_text(json.dumps({**about, "algorithm": "recipe-quick"}))
    with pytest.raises(InvalidInputError, match=r"expected recipes with --budget full"):
        collect(recipe, ["six"])
    (recipe / "run.json").write_text(json.dumps(about))
    (recipe / "log.csv").write_text("step,minutes\n1,1.5\n")
    with pytest.raises(InvalidInputError, match=r"recipes = .*: expected a finished recipe"):
        collect(recipe, ["six"])


def test_picture__has_the_curves_their_intervals_and_the_optimisers_line(recipe: Path) -> None:
    figure = learning._figure({name: collect(recipe, ["six"]) for name in ("six", "other")})
    panel, other = figure.axes
    assert (panel.get_title(), other.get_title()) == ("six", "other")
    lines = {line.get_label(): line for line in panel.lines}
    assert lines["ppo"].get_ydata().tolist() == pytest.approx([50, 70, 75])
    assert lines["dqn+critic"].get_xdata().tolist() == [0.0, 0.5]
    assert set(lines["analytic, (21)"].get_ydata()) == {60.0}
    low, high = wilson95(28, 40)  # 0.7 of 40
    corners = panel.collections[0].get_paths()[0].vertices
    at_two = sorted({y for x, y in corners.tolist() if x == 2.0})
    assert at_two == pytest.approx([100 * low, 100 * high])


def test_results__show_a_recipe(
    recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DATA", "PAGE", "CURVES"):
        monkeypatch.setattr(results, name, tmp_path / name.lower())
    (tmp_path / "data").mkdir()
    for path in (Path(results.__file__).parent.parent / "docs" / "data").glob("*.json"):
        if not path.name.startswith("recipe-"):
            (tmp_path / "data" / path.name).write_bytes(path.read_bytes())
    told = json.loads((recipe / "models" / "validation.json").read_text())
    names = ("value", "imitate", "imitate+critic", "ppo+critic", "dqn+critic")
    told |= {name: {"success": 41, "n": 50} for name in names}
    (recipe / "models" / "validation.json").write_text(json.dumps(told))
    assert results.main(["--recipes", str(recipe)]) == 0
    page = (tmp_path / "page").read_text()
    assert "| `six` | `0123` | 1.5 | 2.5 | 3.5 | 12 |" in page
    assert "| `six` | 50 | 30 | 41 | 41 | 41 | 31 | 41 | 32 | 41 |" in page
    assert (tmp_path / "curves").read_bytes().startswith(b"\x89PNG")


@pytest.fixture
def scratch(tmp_path: Path) -> Path:
    """The folder of a finished run without a student, as far as it is read."""
    folder = tmp_path / "ppo-six-s1"
    folder.mkdir()
    config = {"params": {"n_joints": 6}, "seed": 1, "init": None, "timesteps": 3000}
    about = {"schema": 1, "algorithm": "ppo", "robot": "six", "git": "0123", "versions": {}}
    about |= {"command": "python -m train ppo", "config": {**config, "validation_tasks": 40}}
    (folder / "run.json").write_text(json.dumps(about))
    (folder / "log.csv").write_text(
        "timesteps,frames_per_s,raw_success,raw_time_s,critic_success,critic_time_s\n"
        "500,,,,,\n1000,100,0.2,60.0,0.5,50.0\n2000,,,,,\n3000,50,0.3,61.5,0.6,51.5\n"
    )
    return folder


def test_run_from_scratch__gives_its_last_validation_and_its_minutes(scratch: Path) -> None:
    assert collect_scratch(scratch, ["six"]) == {
        "algorithm": "ppo",
        "robot": "six",
        "command": "python -m train ppo",
        "git": "0123",
        "seed": 1,
        "timesteps": 3000,
        "minutes": pytest.approx((1000 / 100 + 2000 / 50) / 60),
        "count": 40,
        "raw_success": 0.3,
        "raw_time_s": 61.5,
        "critic_success": 0.6,
        "critic_time_s": 51.5,
    }


@pytest.mark.parametrize(
    ("changes", "reason"),
    [({"init": "0a1b"}, "without --init"), ({"timesteps": 4000}, "a finished run")],
)
def test_run_with_a_student_or_without_an_end__is_no_reference(
    scratch: Path, changes: dict[str, Any], reason: str
) -> None:
    about = json.loads((scratch / "run.json").read_text())
    about["config"] |= changes
    (scratch / "run.json").write_text(json.dumps(about))
    with pytest.raises(InvalidInputError, match=rf"scratch = .*{reason}"):
        collect_scratch(scratch, ["six"])


def _about(folder: Path, algorithm: str, config: dict[str, Any]) -> None:
    about = {"schema": 1, "algorithm": algorithm, "robot": "six", "git": "0123", "versions": {}}
    config = {"params": {"n_joints": 6}, "seed": 2, **config}
    folder.mkdir(exist_ok=True)
    (folder / "run.json").write_text(json.dumps({**about, "command": "", "config": config}))


def test_seed__is_a_recipe_or_a_run_that_began_with_a_student(scratch: Path) -> None:
    _about(scratch, "ppo", {"init": "0a1b", "timesteps": 3000})
    own = {"robot": "six", "git": "0123", "seed": 2}
    assert collect_seed(scratch, RECIPES) == {
        **own,
        "trained": "learners",
        "models": {"ppo": scratch / "last.safetensors"},
    }
    recipe = scratch.parent / "recipe"
    _about(recipe, "recipe-quick", {})
    with pytest.raises(InvalidInputError, match=r"seeds = .*a finished recipe"):
        collect_seed(recipe, RECIPES)
    (recipe / "models").mkdir()
    (recipe / "models" / "validation.json").write_text("{}")
    models = {name: recipe / "models" / f"{name}.safetensors" for name in ("ppo", "dqn")}
    assert collect_seed(recipe, RECIPES) == {**own, "trained": "recipe-quick", "models": models}


@pytest.mark.parametrize(
    ("algorithm", "changes", "reason"),
    [
        ("ppo", {"init": None, "timesteps": 3000}, "with --init"),
        ("ppo", {"init": "0a1c", "timesteps": 3000}, "began with the student of the recipe of six"),
        ("dqn", {"init": "0a1b", "timesteps": 4000}, "a finished run"),
        ("value", {"init": None}, "recipes, or runs"),
        ("recipe-own", {}, "recipes, or runs"),
    ],
)
def test_other_runs__are_no_seeds(
    scratch: Path, algorithm: str, changes: dict[str, Any], reason: str
) -> None:
    _about(scratch, algorithm, changes)
    with pytest.raises(InvalidInputError, match=rf"seeds = .*{reason}"):
        collect_seed(scratch, RECIPES)
    with pytest.raises(InvalidInputError, match="seeds = "):
        collect_seed(scratch, {"paper": {"student": "0a1b"}})
