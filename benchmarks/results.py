"""The results of the documentation: ``python -m benchmarks.results [--run]``, or ``make results``.

``--run`` evaluates and measures, and keeps the figures in ``docs/data``; without it the page
``docs/results.md`` is written from the figures that are there.
"""

from __future__ import annotations

import functools
import json
import re
import statistics
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from benchmarks import learning
from benchmarks.kernel import timed
from benchmarks.operations import processor
from benchmarks.vector import native
from evaluate.table import interval
from harness.files import read_json
from harness.folder import writable_folder
from harness.options import parse
from harness.provenance import revision
from snake_env.errors import InvalidInputError, SnakeEnvError, UnknownNameError
from snake_env.kernel.compiler import vector_bits
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies.registry import CRITIC
from snake_env.policies.value import shipped
from snake_env.sim.simulation import predict
from snake_env.sim.slip import NO_SLIP, Slip
from snake_env.sim.tasks import load_tasks
from snake_env.system.exit_code import exit_code
from snake_env.system.files import write_atomically

ROOT = Path(__file__).parent.parent
DATA = ROOT / "docs" / "data"
TEMPLATES = ROOT / "docs"
CURVES = ROOT / "docs" / "images" / "learning.png"
PAGE, TEMPLATE = ROOT / "docs" / "results.md", "results.md.jinja"
_SECONDS = 2.0
LEARNED = ("value", "ppo", "dqn", "imitate+critic", "ppo+critic", "dqn+critic")


@dataclass(frozen=True)
class Evaluation:
    """Policies on a suite of tasks."""

    preset: str
    tasks: str
    more: tuple[str, ...] = ()
    slip: Slip = NO_SLIP


EVALUATIONS = {
    "experiment": Evaluation("paper", "paper-500", ("analytic-14", "lookahead:width=4", "skid")),
    "paper": Evaluation("paper", "test-10k"),
    "narrow": Evaluation("narrow", "test-2k"),
    "six": Evaluation("six", "test-2k", ("lookahead:width=4",)),
    "ten": Evaluation("ten", "test-2k"),
    "hardware": Evaluation("hardware", "test-2k", ("lookahead:width=4",), (0.001, 0.005)),
}
"""By the name of the file in ``docs/data``."""
ROBOTS = tuple(name for name in EVALUATIONS if name != "experiment")


@dataclass(frozen=True)
class Options:
    """Write docs/results.md from the figures in docs/data; --run measures them first."""

    run: bool = False
    """Evaluate the shipped policies and measure the speeds: about half an hour on two cores, and as
    long again for --seeds."""
    only: tuple[str, ...] = ()
    """With --run, only these: experiment, paper, narrow, six, ten, hardware, speed."""
    recipes: tuple[Path, ...] = ()
    """Folders of finished recipes: the page shows how they learned."""
    scratch: tuple[Path, ...] = ()
    """Folders of finished runs of train ppo and train dqn without --init, as a reference."""
    seeds: tuple[Path, ...] = ()
    """Folders of finished recipes of other seeds, or of runs of train ppo and train dqn that began
    with a recipe's student: their models are evaluated."""


def main(args: list[str] | None = None) -> int:
    """Runs what is asked for, and writes the page; the exit code."""
    options = parse(Options, "python -m benchmarks.results", args)
    known = [*EVALUATIONS, "speed"]
    for name in options.only:
        if name not in known:
            raise UnknownNameError("part of the results", name, known)
    learned = [learning.collect(folder, ROBOTS) for folder in options.recipes]
    found = {f"recipe-{recipe['robot']}": recipe for recipe in learned}
    if options.scratch:
        runs = [learning.collect_scratch(folder, ROBOTS) for folder in options.scratch]
        found["scratch"] = {"runs": runs}
    recipes = _recipes() | {recipe["robot"]: recipe for recipe in learned}
    trained = [learning.collect_seed(folder.resolve(), recipes) for folder in options.seeds]
    for name in (options.only or known) if options.run else ():
        found[name] = speeds() if name == "speed" else evaluated(name, EVALUATIONS[name])
    if trained:
        found["seeds"] = {"runs": seeds(trained)}
    writable_folder(DATA)
    for name, figures in found.items():  # all at once: until then the tree is as committed
        write_atomically(DATA / f"{name}.json", _text(figures))
    if recipes:
        learning.draw(recipes, CURVES)
    write_atomically(PAGE, page())
    print(f"written: {PAGE}")
    return 0


def evaluated(name: str, evaluation: Evaluation) -> dict[str, Any]:
    """What ``summary.json`` says of an evaluation, without what no table shows.

    Of the learned policies those are evaluated that ship for the robot.
    """
    params = SnakeParams.preset(evaluation.preset)
    ships = [
        policy
        for policy in LEARNED
        if any(not params.differences(m.params) for m in shipped(policy.partition("+")[0]))
    ]
    summary = _evaluate(name, evaluation, [*ships, *evaluation.more])
    kept = ["policies", "comparisons", "models", "tasks", "preset", "slip"]
    kept += ["command", "git", "versions"]
    return {"processor": processor(), **{key: summary[key] for key in kept}}


def _evaluate(name: str, evaluation: Evaluation, policies: Sequence[str], *more: str) -> Any:
    """The summary of an evaluation; one of a committed revision that was interrupted continues."""
    source = revision() or "+"
    out = ROOT / "build" / "results" / source.rstrip("+") / name
    again = "--overwrite" if source.endswith("+") else "--resume"  # what has changed is run again
    words = ["analytic", *policies, "--tasks", evaluation.tasks]
    words += ["--preset", evaluation.preset, "--no-pictures", again, "--out", str(out), *more]
    if any(evaluation.slip):
        words += ["--slip", *map(str, evaluation.slip)]
    done = subprocess.run([sys.executable, "-m", "evaluate", *words], cwd=ROOT)
    if done.returncode:
        raise SnakeEnvError(f"python -m evaluate {' '.join(words)}: exit code {done.returncode}")
    return read_json(out / "summary.json")


def seeds(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """How the models of other seeds do on the tasks of their robots.

    Args:
        runs: What :func:`benchmarks.learning.collect_seed` says of each.

    Returns:
        For each robot, way of training and seed: ``robot``, ``trained``, ``seed``; ``trained_at`` and
        ``git``, the revisions that trained and that evaluated them; and of each of the ``policies``,
        such as "ppo+critic", ``success_rate`` and ``time_ratio``.

    Raises:
        InvalidInputError: A seed is there twice.
    """
    found: dict[Any, dict[str, Any]] = {}
    for robot in ROBOTS:
        files: dict[tuple[str, int, str], str] = {}
        revisions: dict[tuple[str, int], set[str]] = {}
        for run in [run for run in runs if run["robot"] == robot]:
            revisions.setdefault((run["trained"], run["seed"]), set()).add(run["git"])
            for learner, file in run["models"].items():
                if (run["trained"], run["seed"], learner) in files:
                    raise InvalidInputError("seeds", str(file), "each seed once")
                for suffix in ("", CRITIC):
                    files[run["trained"], run["seed"], f"{learner}{suffix}"] = f"{file}{suffix}"
        if not files:
            continue
        summary = _evaluate(
            f"seeds-{robot}", EVALUATIONS[robot], list(files.values()), "--no-latency"
        )
        for (trained, seed, policy), file in sorted(files.items()):
            about = {"robot": robot, "trained": trained, "seed": seed, "git": summary["git"]}
            about["trained_at"] = sorted(revisions[trained, seed])
            row = found.setdefault((robot, trained, seed), {**about, "policies": {}})
            row["policies"][policy] = {
                "success_rate": summary["policies"][file]["success_rate"],
                "time_ratio": (_against(summary, file) or {}).get("time_ratio"),
            }
    return list(found.values())


def speeds() -> dict[str, Any]:
    """Durations of the kernel's work and of the vector env's, medians, and the machine."""
    params = SnakeParams()
    state = load_tasks("sim-1", params).initial(0, params)
    modes = mode_table(params.n_joints).valid(1)
    found: dict[str, Any] = {"processor": processor(), "bits": vector_bits(), "git": revision()}
    for count in (1, 8, 99):
        (times,) = timed(functools.partial(predict, state, modes[:count], params), repeats=200)
        found[f"predict_{count}_us"] = 1e6 * statistics.median(times)
    found["vector_steps_per_s"] = native(512).run(_SECONDS)
    return found


def page() -> str:
    """``docs/results.md`` from the figures in ``docs/data``."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "interval": interval,
        "num": _number,
        "estimate": _estimate,
        "cell": _cell,
        "names": _names,
    }
    robots = {name: _data(name) for name in ROBOTS}
    runs = (_data("seeds") or {"runs": []})["runs"]
    text = environment.get_template(TEMPLATE).render(
        experiment=_data("experiment"),
        robots={name: data for name, data in robots.items() if data},
        speed=_data("speed"),
        recipes=_recipes(),
        scratch=(_data("scratch") or {"runs": []})["runs"],
        seeds=runs,
        origins=_origins(),
        revisions=sorted(
            {data["git"] for data in [_data("speed"), *map(_data, EVALUATIONS), *runs] if data}
        ),
        against=_against,
    )
    as_it_is = ("|", "#", "```", "![")  # tables, headings, code, pictures
    blocks = re.split(r"\n{2,}", text.strip())
    wrapped = [b if b.startswith(as_it_is) else textwrap.fill(b, 100) for b in blocks]
    return "\n\n".join(wrapped) + "\n"


def _data(name: str) -> Any:
    file = DATA / f"{name}.json"
    return read_json(file) if file.exists() else None


def _recipes() -> dict[str, Any]:
    """What the recipes of the robots have learned."""
    found = {robot: _data(f"recipe-{robot}") for robot in ROBOTS}
    return {robot: recipe for robot, recipe in found.items() if recipe}


def _origins() -> dict[str, list[str]]:
    """The robots whose networks the recipe made, those with older ones, and those without any."""
    found: dict[str, list[str]] = {"recipe": [], "older": [], "none": []}
    for robot in ROBOTS:
        params = SnakeParams.preset(robot)
        models = [model for model in shipped("ppo") if not params.differences(model.params)]
        origin = "none" if not models else "recipe" if "stages" in models[0].made else "older"
        found[origin].append(robot)
    return found


def _names(robots: list[str]) -> str:
    """Names in a sentence."""
    *first, last = [f"`{robot}`" for robot in robots]
    return f"{', '.join(first)} and {last}" if first else last


def _against(data: dict[str, Any], policy: str) -> dict[str, Any] | None:
    """A policy's comparison with (21)."""
    return next((entry for entry in data["comparisons"] if entry["policy"] == policy), None)


def _text(data: dict[str, Any]) -> str:
    return json.dumps(data, indent=1) + "\n"


def _cell(share: float, time_ratio: dict[str, float] | None) -> str:
    """Success [%], and the time against (21)'s."""
    return f"{100 * share:.2f}, " + ("-" if time_ratio is None else f"{time_ratio['mean']:.3f}")


def _number(value: float | None, digits: int = 1) -> str:
    return "-" if value is None else f"{value:,.{digits}f}"


def _estimate(estimate: dict[str, float] | None, digits: int = 3) -> str:
    if estimate is None:
        return "-"
    mean, low, high = (f"{estimate[key]:.{digits}f}" for key in ("mean", "low", "high"))
    return f"{mean} ({low}-{high})"


if __name__ == "__main__":
    sys.exit(exit_code(main))
