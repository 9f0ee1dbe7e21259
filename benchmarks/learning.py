"""What recipes have learned, stage by stage: figures for ``docs/data``, and a picture of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from evaluate.statistics import wilson95
from harness.figures import Figure, matplotlib, save, style
from harness.files import read_json
from snake_env.errors import InvalidInputError
from train.models import TABLE
from train.recipe import ORDER
from train.records import read_about, read_log

LEARNERS = ("ppo", "dqn")
_COLOURS = {"ppo": "#0b6e4f", "dqn": "#b3541e"}
_STYLE: dict[str, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "legend.frameon": False,
}


def collect(recipe: Path, robots: Collection[str]) -> dict[str, Any]:
    """The figures of a finished recipe.

    Args:
        recipe: Its folder.
        robots: Those that there are results of.

    Returns:
        ``robot``, ``command``, ``git``, ``seed``; ``student``: SHA-256 of what PPO and DQN began with;
        ``minutes`` of each step; ``final``: how its models and (21) do; ``count``: tasks of a
        validation; ``curves``: for each learner the decisions, in millions, and the shares of tasks
        solved, raw and with ``+critic``; first the student's.

    Raises:
        InvalidInputError: It is no finished recipe, or damaged.
    """
    about = read_about(recipe, "recipes")
    if about["algorithm"] != "recipe-full" or about["robot"] not in robots:
        found = f"{recipe}: {about['algorithm']} of {about['robot']}"
        expected = f"recipes with --budget full, of {', '.join(robots)}"
        raise InvalidInputError("recipes", found, expected)
    names = [", ".join(level) for level in ORDER]
    minutes = [float(row["minutes"]) for row in read_log(recipe / "log.csv")]
    if len(minutes) != len(names):
        expected = f"a finished recipe of {len(names)} steps (--resume finishes it)"
        raise InvalidInputError("recipes", str(recipe), expected)
    *_, student = read_log(recipe / "imitate" / "log.csv", "round")
    curves = {}
    for learner in LEARNERS:
        rows = [row for row in read_log(recipe / learner / "log.csv") if row["raw_success"]]
        curves[learner] = [
            [int(row.get("timesteps", 0)) / 1e6, *(float(row[key]) for key in _SHARES)]
            for row in (student, *rows)
        ]
    return {
        "robot": about["robot"],
        "command": about["command"],
        "git": about["git"],
        "seed": about["config"]["seed"],
        "student": read_about(recipe / LEARNERS[0], "recipes")["config"]["init"],
        "minutes": dict(zip(names, minutes, strict=True)),
        "final": read_json(recipe / "models" / TABLE),
        "count": about["config"]["stages"]["ppo"]["validation_tasks"],
        "curves": curves,
    }


_SHARES = ("raw_success", "critic_success")


def collect_scratch(run: Path, robots: Collection[str]) -> dict[str, Any]:
    """The figures of a finished run of PPO or DQN that began with random weights.

    Args:
        run: Its folder.
        robots: Those that there are results of.

    Returns:
        ``algorithm``, ``robot``, ``command``, ``git``, ``seed``; ``timesteps``, and ``minutes`` of
        learning; of its last validation ``count`` tasks, ``raw_success``, ``critic_success``,
        ``raw_time_s`` and ``critic_time_s``.

    Raises:
        InvalidInputError: It is no such run, or damaged.
    """
    about = read_about(run, "scratch")
    config = about["config"]
    if about["algorithm"] not in LEARNERS or about["robot"] not in robots or config["init"]:
        found = f"{run}: {about['algorithm']} of {about['robot']}"
        expected = f"runs of train ppo or dqn without --init, of {', '.join(robots)}"
        raise InvalidInputError("scratch", found, expected)
    rows = _finished(run, config, "scratch")
    ends = [row for row in rows if row["frames_per_s"]]
    decisions = np.diff([0, *(int(row["timesteps"]) for row in ends)])
    seconds = decisions / [float(row["frames_per_s"]) for row in ends]
    return {
        **{key: about[key] for key in ("algorithm", "robot", "command", "git")},
        "seed": config["seed"],
        "timesteps": int(rows[-1]["timesteps"]),
        "minutes": float(seconds.sum()) / 60.0,
        "count": config["validation_tasks"],
        **{key: float(rows[-1][key]) for key in (*_SHARES, "raw_time_s", "critic_time_s")},
    }


def _finished(run: Path, config: Mapping[str, Any], field: str) -> list[dict[str, str]]:
    """The log of a run of PPO or DQN, which ends with a validation."""
    rows = read_log(run / "log.csv")
    if not rows or int(rows[-1]["timesteps"]) < config["timesteps"] or not rows[-1]["raw_success"]:
        raise InvalidInputError(field, str(run), "a finished run (--resume finishes it)")
    return rows


def collect_seed(run: Path, recipes: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """What a finished recipe has made, or a finished run of PPO or DQN that began with a student.

    Args:
        run: Its folder.
        recipes: What :func:`collect` says of each robot's recipe.

    Returns:
        ``robot``; ``trained``: "recipe-quick", "recipe-full", or "learners"; ``seed``; ``git``, the
        revision that trained it; ``models``: the files by learner, "ppo" and "dqn".

    Raises:
        InvalidInputError: It is no such run, damaged, or began with another student than the recipe's
            learners.
    """
    about = read_about(run, "seeds")
    robot, algorithm, config = about["robot"], about["algorithm"], about["config"]
    if robot in recipes and algorithm in LEARNERS and config["init"]:
        _finished(run, config, "seeds")
        if config["init"] != recipes[robot]["student"]:
            expected = f"a run that began with the student of the recipe of {robot}"
            raise InvalidInputError("seeds", str(run), expected)
        trained, models = "learners", {algorithm: run / "last.safetensors"}
    elif robot in recipes and algorithm in ("recipe-quick", "recipe-full"):
        if not (run / "models" / TABLE).is_file():
            raise InvalidInputError("seeds", str(run), "a finished recipe (--resume finishes it)")
        trained = algorithm
        models = {name: run / "models" / f"{name}.safetensors" for name in LEARNERS}
    else:
        found = f"{run}: {algorithm} of {robot}"
        known = ", ".join(recipes) or "robots with --recipes"
        expected = f"recipes, or runs of train ppo or dqn with --init, of {known}"
        raise InvalidInputError("seeds", found, expected)
    about = {"robot": robot, "git": about["git"], "seed": config["seed"]}
    return {**about, "trained": trained, "models": models}


def draw(recipes: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Draws the curves of some robots' recipes, a panel each, with 95 % intervals and (21)'s line."""
    with style(_STYLE):
        save(_figure(recipes), path)


def _figure(recipes: Mapping[str, Mapping[str, Any]]) -> Figure:
    columns = min(3, len(recipes))
    rows = -(-len(recipes) // columns)
    size = (3.4 * columns, 2.7 * rows + 0.5)
    figure = Figure(figsize=size, layout="constrained", dpi=150)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, (robot, recipe) in zip(panels, recipes.items(), strict=False):
        _panel(panel, recipe)
        panel.set_title(robot)
        panel.set_xlabel("million decisions")
        panel.set_ylabel("tasks solved [%]")
    for panel in panels[len(recipes) :]:
        panel.set_visible(False)
    lines, names = panels[0].get_legend_handles_labels()
    figure.legend(lines, names, loc="outside lower center", ncols=5 if columns > 1 else 2)
    return figure


def _panel(panel: Any, recipe: Mapping[str, Any]) -> None:
    for learner, curve in recipe["curves"].items():
        decisions, *shares = np.array(curve).T
        for name, share, dashes in zip(
            (learner, f"{learner}+critic"), shares, ("--", "-"), strict=True
        ):
            solved = np.rint(share * recipe["count"]).astype(int).tolist()
            bounds = np.array([wilson95(number, recipe["count"]) for number in solved]).T
            colour = _COLOURS[learner]
            panel.plot(decisions, 100 * share, dashes, color=colour, marker=".", ms=4, label=name)
            panel.fill_between(decisions, *(100 * bounds), color=colour, alpha=0.1, lw=0)
    base = recipe["final"]["analytic"]
    panel.axhline(
        100 * base["success"] / base["n"], color="black", lw=1, ls=":", label="analytic, (21)"
    )
    panel.yaxis.set_major_locator(matplotlib.ticker.MaxNLocator(5))
    panel.set_xlim(left=0.0)
