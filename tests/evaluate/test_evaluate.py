"""``python -m evaluate`` through a subprocess: what it writes, refuses and survives."""

import contextlib
import dataclasses
import io
import itertools
import json
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from evaluate import __main__ as command
from evaluate.protocol import Shard, run_episode, run_shard
from evaluate.statistics import summarise, wilson95
from evaluate.table import printed, result_tables
from evaluate.terminal import print_comparisons
from harness.console import PlainConsole, console
from harness.engine import Engine, WorkerLostError
from snake_env.policies.baselines import FirstFeasiblePolicy
from snake_env.policies.registry import POLICIES
from snake_env.sim.episode import OUTCOMES
from snake_env.sim.tasks import random_suite
from snake_env.state import SnakeState
from tests.support import HANGS_S, ROOT
from tests.support.commands import Command, names, python, tree, wait_until
from tests.support.evaluations import episodes
from tests.support.robots import PAPER

EVALUATE = Command(command.main)
POLICY_KEYS = {
    *("n", "success", "success_rate", "wilson95", "time_s", "restricted_mean_time_s"),
    *("cost_integral", "d_min", "max_abs_phi", "violations", "rollouts_per_decision"),
    *("decision_latency_us", "shape_error_rad", "name"),
}
SIXTY = [
    *(15, 13, 12, 12, 13, 15, 12, 10, 12, 13, 17, 16, 15, 14, 19, 9, 15, 15, 16, 13),
    *(16, 14, 15, 12, 13, 13, 14, 16, 16, 13, 13, 15, 11, 12, 17, 16, 18, 16, 16, 16),
    *(12, 13, 17, 13, 12, 15, 15, 12, 16, 15, 14, 14, 13, 13, 18, 9, 13, 13, 11, 15),
]  # intervals that (21) needs
ROW = {
    "outcome": "success", "policy": "analytic", "time_s": 291.0, "shape_error_rad": 0.0345,
    "phase": 9, "cost_integral": 12.345, "d_min": 0.1784, "max_abs_phi": 1.57079,
    "head_error_m": 0.49, "head_error_rad": 2.02, "rollouts": 12, "intervals": 97,
    "modes": " ".join(["7"] * 97),
}  # fmt: skip
HALTING = "tests.support.policies_of_others:Halting"
LONG = ("--policy", HALTING, "--tasks", "random:80:1", "--no-latency", "--no-pictures", "--out")
"""A command that is in the middle of its work for as long as a test wants."""


def _good(*arguments: object) -> str:
    done = EVALUATE.process(*arguments)
    assert all("compiling" in line for line in done.stderr.splitlines()), done.stderr
    return done.stdout


def _summary(folder: Path) -> dict[str, Any]:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads((folder / "summary.json").read_text(), parse_constant=refuse)


def _same(one: Path, other: Path) -> None:
    """Asserts that two folders hold the same bytes."""
    for name in ("episodes.csv", "summary.json"):
        assert (one / name).read_bytes() == (other / name).read_bytes()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("evaluate")


@pytest.fixture(scope="module")
def report(folder: Path) -> Path:
    """Results of some policies on 6 tasks, made by one worker, and what was printed."""
    out = folder / "new" / "report"
    table = _good(
        "analytic", "random", "skid", "--tasks", "random:6:3", "--workers", 1, "--out", out
    )
    (folder / "table").write_text(table)
    return out


@pytest.fixture(scope="module")
def reference(folder: Path) -> Path:
    """The long run, uninterrupted."""
    _good(*LONG, folder / "long", "--workers", 2)
    return folder / "long"


def test_report__is_complete(report: Path) -> None:
    pictures = {f"fig4-{name}.png" for name in ("analytic", "random", "skid")}
    pictures |= {"sim-1-traces-analytic.png", "sim-1-film-analytic.png"}
    files = {"report.html", "summary.json", "episodes.csv", *pictures}
    assert names(report) == files
    assert "random:6:3" in (report / "report.html").read_text(encoding="utf-8")
    for name in pictures:
        with Image.open(report / name) as image:
            assert image.format == "PNG"
            assert min(image.size) > 300
            colours = image.convert("RGB").getcolors(maxcolors=1 << 24)
        assert len(colours) > 20
        assert max(count for count, _ in colours) < 0.98 * image.size[0] * image.size[1]


def test_episodes__are_a_row_per_policy_and_task(report: Path) -> None:
    header = (report / "episodes.csv").read_text().splitlines()[0].split(",")
    assert header[:5] == ["policy", "task", "outcome", "intervals", "time_s"]
    rows = episodes(report)
    expected = [(name, str(k)) for name in ("analytic", "random", "skid") for k in range(6)]
    assert [(row["policy"], row["task"]) for row in rows] == expected
    assert {row["outcome"] for row in rows} <= set(OUTCOMES)
    for row in rows:
        if row["policy"] != "skid":
            modes = len(row["modes"].split())
            assert modes == int(row["intervals"])
            assert float(row["time_s"]) <= 3.0 * modes
        assert row["outcome"] != "success" or row["phase"] == "9"


def test_summary__says_what_the_episodes_say(report: Path) -> None:
    summary, rows = _summary(report), episodes(report)
    assert list(summary["policies"]) == ["analytic", "random", "skid"]
    assert summary["preset"] == "paper"
    assert summary["tasks"]["name"] == "random:6:3"
    command = "python -m evaluate analytic random skid --tasks random:6:3 --preset paper"
    assert summary["command"] == command
    pairs = [(entry["reference"], entry["policy"]) for entry in summary["comparisons"]]
    assert pairs == [("analytic", "random")]
    assert summary["profiles"].keys() == summary["policies"].keys() - {"skid"}
    assert summary["seeds"] == {}
    for name, figures in summary["policies"].items():
        assert figures.keys() >= POLICY_KEYS
        own = [row for row in rows if row["policy"] == name]
        times = [float(row["time_s"]) for row in own if row["outcome"] == "success"]
        assert (figures["n"], figures["success"]) == (6, len(times))
        assert figures["success_rate"] == len(times) / 6
        assert figures["wilson95"] == list(wilson95(len(times), 6))
        told = [figures["time_s"][key] for key in ("min", "median", "mean", "max")]
        functions = (min, statistics.median, statistics.mean, max)
        assert told == pytest.approx([function(times) for function in functions])
        restricted = (sum(times) + 300.0 * (6 - len(times))) / 6
        assert figures["restricted_mean_time_s"] == pytest.approx(restricted)
        assert figures["d_min"] == min(float(row["d_min"]) for row in own)
        assert figures["max_abs_phi"] == max(float(row["max_abs_phi"]) for row in own)
        outcomes = Counter(row["outcome"] for row in own)
        assert figures["outcomes"] == outcomes
        names = ("stability", "joint_limit", "collision")
        assert figures["violations"] == sum(outcomes[outcome] for outcome in names)
    analytic = summary["policies"]["analytic"]
    own = [row for row in rows if row["policy"] == "analytic"]
    spent = sum(int(row["rollouts"]) for row in own)
    assert analytic["rollouts_per_decision"] == spent / sum(int(row["intervals"]) for row in own)
    latency = analytic["decision_latency_us"]
    assert 0 < latency["p50"] <= latency["p95"] <= latency["p99"]
    assert summary["policies"]["random"]["rollouts_per_decision"] == 0
    assert summary["policies"]["skid"]["cost_integral"] is None


def test_names__are_printed_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    """A terminal library may take :100: for a picture and [x] for a style."""
    print_comparisons(
        console(), {"comparisons": [{"sentence": "random:100:1 and a[red].npz"}], "seeds": {}}
    )
    assert capsys.readouterr().out == "random:100:1 and a[red].npz\n"


def test_analytic__solves_60_tasks_as_it_did(folder: Path) -> None:
    out = folder / "sixty"
    _good("analytic", "--tasks", "random:60:60", "--no-pictures", "--out", out)
    rows = episodes(out)
    assert {row["outcome"] for row in rows} == {"success"}
    assert [int(row["intervals"]) for row in rows] == SIXTY
    assert all(float(row["time_s"]) == 3.0 * int(row["intervals"]) for row in rows)


def test_paper_500__gives_the_headline(folder: Path) -> None:
    out = folder / "paper-500"
    _good("analytic", "--no-pictures", "--out", out)
    summary = _summary(out)["policies"]["analytic"]
    assert (summary["n"], summary["success"]) == (500, 498)
    assert summary["failures_by_phase"] == {"deadlock in phase 7": 2}
    time_s = summary["time_s"]
    assert (time_s["min"], time_s["median"], time_s["max"]) == (27.0, 42.0, 108.0)
    assert time_s["mean"] == pytest.approx(42.6, abs=0.05)
    assert 0.175 < summary["d_min"] < 0.185
    assert summary["max_abs_phi"] <= np.pi / 2 + 1e-6
    assert summary["head_error_m"] == summary["head_error_rad"] == 0.0


def test_table__quotes_the_paper_beside_our_figures(folder: Path, report: Path) -> None:
    table = (folder / "table").read_text()
    quoted, quoted_motion, quoted_cost = [
        line.split() for line in table.splitlines() if "quoted" in line
    ]
    assert quoted[2:] == ["496/500", "98.0-99.7", "27", "-", "-", "180"]
    assert quoted_motion[2:4] == ["0.18", "<="]
    assert quoted_cost[2:] == ["<=", "99", "-", "<=", "150000"]
    own = next(line.split() for line in table.splitlines() if line.split()[:1] == ["analytic"])
    assert own == ["analytic", "6/6", "61.0-100.0", "33", "39", "39.5", "51"]
    assert str(report) in table


def test_tables__fit_into_80_columns() -> None:
    summary = {
        "tasks": {"name": "random:10000:12345", "n": 10_000},
        "preset": "paper",
        "params": dataclasses.asdict(PAPER),
        "slip": [0.0, 0.0],
        "policies": {
            name: summarise([ROW] * 10_000, [123_456.0] * 9, PAPER)
            for name in ("analytic", "first-feasible")
        },
    }
    out = io.StringIO()
    for table in result_tables(summary):
        PlainConsole(file=out, width=80).print(printed(table, "text"))
    text = out.getvalue()
    assert "\u2026" not in text  # nothing is cut off
    figures = "10000/10000", "first-feasible", "1.5708", "12.3", "123456", "496/500", "max [s]"
    assert all(figure in text for figure in figures)


def test_results__do_not_depend_on_the_workers(folder: Path, report: Path) -> None:
    arguments = ("analytic", "random", "skid", "--tasks", "random:6:3", "--no-latency")
    for workers in (1, 2):
        out = folder / f"workers-{workers}"
        _good(*arguments, "--workers", workers, "--no-pictures", "--out", out)
        assert names(out) == {"summary.json", "episodes.csv"}
    _same(folder / "workers-1", folder / "workers-2")
    assert (out / "episodes.csv").read_bytes() == (report / "episodes.csv").read_bytes()


def test_task_file__gives_what_its_tasks_give(folder: Path, report: Path) -> None:
    suite = random_suite(6, 3, PAPER)
    np.savez(folder / "tasks.npz", phi0=suite.phi0[:4], target=suite.target[:4])
    out = folder / "from-file"
    table = _good("analytic", "--tasks", folder / "tasks.npz", "--no-pictures", "--out", out)
    assert episodes(out) == episodes(report)[:4]
    assert _summary(out)["tasks"]["n"] == 4
    assert "tasks.npz: 4 tasks" in table


def test_other_constants__reach_the_robot(folder: Path) -> None:
    out = folder / "six"
    arguments = ("analytic", "first-feasible", "--tasks", "random:3:1", "--set", "n_joints=6")
    table = _good(*arguments, "--set", "gains=[1, 1, 0.5, 1.5]", "--preset", "narrow", "--out", out)
    assert "quoted" not in table
    params = _summary(out)["params"]
    assert (params["n_joints"], params["head_contact"]) == (6, False)
    assert params["gains"] == [1, 1, 0.5, 1.5]
    for row in episodes(out):
        assert all(int(mode) < 16 for mode in row["modes"].split())  # 1 + 5 + 10 modes
    drawn = {path.name for path in out.glob("*.png")}
    assert drawn == {"fig4-analytic.png", "fig4-first-feasible.png"}  # sim-1 has 8 joints


BAD = {
    "": r"POLICY = \(\): expected at least one policy",
    "analytc": r"unknown policy 'analytc': did you mean 'analytic'\?",
    "analytic skidd": r"unknown policy 'skidd': did you mean 'skid'\?",
    "analytic analytic": r"POLICY = 'analytic': expected each policy once",
    "analytic-14 --set n_joints=6": r"n_joints = 6: expected 8 for the policy analytic-14",
    "random --preset papr": r"unknown preset 'papr': did you mean 'paper'\?",
    "random --set a_cc=67": r"unknown parameter 'a_cc': did you mean 'a_c'\?",
    "random --set a_c": r"set = 'a_c': expected NAME=VALUE",
    "random --set a_c=big": r"set = 'a_c=big': expected NAME=VALUE",
    "random --set a_c=-1": r"a_c = -1.0: expected zero or a positive number",
    "random --set n_joints=4": r"n_joints = 4: expected an integer from 5 to 16",
    "random --workers 0": r"workers = 0: expected a positive number, or -1",
    "random --workers -2": r"workers = -2: expected a positive number, or -1",
    "random --tasks paper-501": r"unknown task suite 'paper-501': did you mean 'paper-500'\?",
    "random --tasks random:0": r"tasks = 'random:0': expected random:N",
    "random --tasks random:x": r"tasks = 'random:x': expected random:N",
    "random --tasks {tmp}/none.npz": r"none\.npz': expected a file that exists",
    "random --tasks {tmp}/objects.npz": r"objects\.npz': expected .*pickled objects are never read",
    "random --out {tmp}/results": r"out = .*results': expected an empty folder",
    "random --out {tmp}/file": r"out = .*file': expected a folder to write to",
    "random --out {tmp}/file/below": r"out = .*below': expected a folder to write to",
    "random --slip -1 0": r"slip = \(-1\.0, 0\.0\): expected \(m, rad\): two numbers",
    "random skid --slip 0.01 0": r"slip = \(0\.01, 0\.0\): expected no slip for skid",
    "random --video 500": r"video = '500': expected default, or a list of sim-1 and tasks from 0",
    "random --overwrite --resume": r"overwrite = True: expected one of --overwrite and --resume",
    "random --resume --out {tmp}/results": r"resume = .*: expected the summary of a run",
    "random --worker 2": "--workers",
    "random --engine rays": "'ray'",
    "random --tasks": "--tasks",
    "random --workers two": "'two'",
}
PROCESSES = ("", "analytc", "random --tasks {tmp}/objects.npz", "random --out {tmp}/file/below")


@pytest.fixture
def bad_files(tmp_path: Path) -> Path:
    """A folder of files that can't be used."""
    (tmp_path / "results").mkdir()
    for path in (tmp_path / "file", tmp_path / "results" / "summary.json"):
        path.write_text("{}")
    np.savez(tmp_path / "objects.npz", phi0=np.array([[None] * 8]), target=np.zeros((3, 8)))
    return tmp_path


def _arguments(case: str, folder: Path) -> list[str]:
    arguments = case.replace("{tmp}", str(folder)).split()
    return arguments if "--out" in arguments else ["--out", str(folder / "out"), *arguments]


@pytest.mark.parametrize("case", BAD)
def test_bad_input__is_refused_in_one_line(
    case: str, bad_files: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    before = tree(bad_files)
    assert re.search(BAD[case], EVALUATE.refusal(capfd, *_arguments(case, bad_files)))
    assert tree(bad_files) == before


@pytest.mark.parametrize("case", PROCESSES)
def test_bad_input__ends_the_process_with_2(case: str, bad_files: Path) -> None:
    before = tree(bad_files)
    done = EVALUATE.process(*_arguments(case, bad_files), code=2)
    assert done.stdout == ""
    assert re.fullmatch(rf"error: [^\n]*{BAD[case]}[^\n]*\n", done.stderr), done.stderr
    assert tree(bad_files) == before


def test_missing_ray__is_named_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    arguments = ("random", "--tasks", "random:2:1", "--engine", "ray", "--out", tmp_path / "out")
    told = EVALUATE.refusal(capfd, *arguments)
    assert told == "--engine ray needs Ray: pip install snake-mode-env[ray]"
    assert not (tmp_path / "out").exists()


def _started(out: Path, workers: int) -> subprocess.Popen[str]:
    """The long run, once some of its shards are on disk."""
    process = EVALUATE.start(*LONG, out, "--workers", workers, HALT="1")
    partial = out / "episodes.partial.jsonl"
    wait_until(lambda: partial.exists() and partial.read_bytes().count(b"\n") >= 41, process)
    return process


def _end(process: subprocess.Popen[str], number: int) -> tuple[str, str]:
    """Sends a signal to the command and its workers, as a terminal does; what they printed.

    The workers get it first: in a terminal, too, it is chance who is faster.
    """
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(ProcessLookupError):
            pid = int(entry.name)
            if pid != process.pid and os.getpgid(pid) == process.pid:
                os.kill(pid, number)
    time.sleep(0.1)
    os.killpg(process.pid, number)
    return process.communicate(timeout=HANGS_S)


def _resume(out: Path, reference: Path) -> None:
    left = 80 - sum(
        len(json.loads(line)["rows"])
        for line in (out / "episodes.partial.jsonl").read_text().splitlines()[1:]
        if line.endswith("}")
    )
    printed = _good(*LONG, out, "--workers", 2, "--resume")
    assert f"\n{left} episodes in " in printed
    _same(out, reference)
    assert names(out) == {"episodes.csv", "summary.json"}


@pytest.mark.parametrize("workers", [1, 2])
def test_interrupted_run__keeps_what_it_has_and_resumes(
    workers: int, reference: Path, tmp_path: Path
) -> None:
    process = _started(tmp_path / "out", workers)
    stdout, stderr = _end(process, signal.SIGINT)
    assert process.returncode == 130, stdout + stderr
    assert "Traceback" not in stdout + stderr
    rows, whole = episodes(tmp_path / "out"), episodes(reference)
    assert 40 <= len(rows) <= 60
    assert [row for row in whole if row in rows] == rows  # in order, and equal
    assert _summary(tmp_path / "out")["policies"][HALTING]["n"] == len(rows)
    (message,) = stderr.splitlines()
    assert f"{len(rows)} finished episodes" in message
    if workers == 2:
        _resume(tmp_path / "out", reference)


def test_killed_run__resumes(reference: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = _started(out, 1)
    _end(process, signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    assert names(out) == {"episodes.partial.jsonl"}
    with (out / "episodes.partial.jsonl").open("a") as file:
        file.write('{"key": ["analytic", 14')  # torn off
    _resume(out, reference)


def test_run_whose_workers_died__keeps_what_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def dying(engine: Engine, work: Any, shards: Iterator[Shard]) -> Iterator[Any]:
        yield from map(work, itertools.islice(shards, 3))
        raise WorkerLostError("workers died 6 times: killed")

    out = tmp_path / "out"
    monkeypatch.setattr(Engine, "map", dying)
    assert EVALUATE.run("random", "--tasks", "random:5:3", "--out", out) == 1
    assert capsys.readouterr().err == (
        "error: workers died 6 times: killed: 3 finished episodes are in "
        f"{out}: --resume continues from there\n"
    )
    assert [row["task"] for row in episodes(out)] == ["0", "1", "2"]
    assert (out / "episodes.partial.jsonl").is_file()


def test_shards_of_many_tasks__give_the_same_rows(
    report: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "_LEAST_SHARDS", 1)
    monkeypatch.setattr(command, "_MOST_TASKS", 4)
    sizes = []
    monkeypatch.setattr(
        command, "run_shard", lambda shard: (sizes.append(len(shard.tasks)), run_shard(shard))[1]
    )
    words = "analytic random skid --tasks random:6:3 --workers 1 --no-pictures --out"
    EVALUATE.good(*words.split(), tmp_path / "out")
    assert sizes == [4, 2] * 3
    assert (tmp_path / "out/episodes.csv").read_bytes() == (report / "episodes.csv").read_bytes()


def test_full_disk__ends_the_run_in_one_line_and_keeps_what_is_finished(
    report: Path, tmp_path: Path
) -> None:
    """The system refuses to let a file grow beyond 2 kB, as a full disk would."""
    out = tmp_path / "out"
    arguments = f"skid --tasks random:6:3 --no-pictures --no-latency --out {out}".split()
    limited = (
        "import resource, sys; from evaluate.__main__ import main; "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2000, -1)); sys.exit(main())"
    )
    done = python("-c", limited, *arguments, "--workers", 1, code=1)
    assert done.stdout == ""
    pattern = (
        r"error: .*File too large: (\d) finished episodes are in .*: --resume continues from there"
    )
    match = re.fullmatch(pattern, done.stderr.strip())
    assert match, done.stderr
    assert 0 < int(match[1]) < 6
    printed = _good(*arguments, "--resume")
    assert "6/6" in printed
    own = [row for row in episodes(report) if row["policy"] == "skid"]
    assert episodes(out) == own


def test_reader_that_goes__ends_the_command_quietly(tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = EVALUATE.start("skid", "--tasks", "random:3:3", "--no-pictures", "--out", out)
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    assert process.stderr.read() == ""
    assert process.wait(60) == 141
    assert len(episodes(out)) == 3  # what was finished is there


def test_full_disk_behind_stdout__is_told_in_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "evaluate", "skid", "--tasks", "random:2:3"],
            cwd=ROOT, text=True, stdout=full, stderr=subprocess.PIPE,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == "error: [Errno 28] No space left on device\n"


def test_sentences__are_the_last_that_is_printed(folder: Path, report: Path) -> None:
    told = [entry["sentence"] for entry in _summary(report)["comparisons"]]
    assert (folder / "table").read_text().splitlines()[-len(told) :] == told


def test_seeds_of_a_method__are_summed_up(tmp_path: Path) -> None:
    shipped = ROOT / "snake_env" / "pretrained" / "imitate"
    models = [tmp_path / f"imitate-s{seed}" / "best.safetensors" for seed in range(2)]
    for model in models:
        model.parent.mkdir()
        shutil.copy(shipped.with_suffix(".safetensors"), model)
    printed = _good(
        "skid", *models, "--tasks", "random:4:3", "--no-latency", "--out", tmp_path / "o"
    )
    (name,) = (seeds := _summary(tmp_path / "o")["seeds"])
    assert name == f"{tmp_path}/imitate-s*/best.safetensors"
    assert seeds[name]["policies"] == list(map(str, models))
    assert printed.splitlines()[-1] == seeds[name]["sentence"]


class _Failing(FirstFeasiblePolicy):
    """Raises in its second decision on the tasks 1 and 12."""

    def reset(self, seed: int | None = None) -> None:
        self.decisions_left = 1 if seed in (1, 12) else 1000

    def select_mode(self, state: SnakeState) -> int:
        if self.decisions_left == 0:
            raise ZeroDivisionError("no idea,\n\u00e9 either")
        self.decisions_left -= 1
        return super().select_mode(state)


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setitem(POLICIES, "failing", _Failing)
    return "failing"


def test_policy_that_raises__ends_its_episode_only(failing: str) -> None:
    suite = random_suite(3, 3, PAPER)
    states = [suite.initial(task, PAPER) for task in range(3)]
    row = run_episode(_Failing(PAPER), states[1], PAPER, 1)
    assert (row["outcome"], row["intervals"], row["time_s"]) == ("error", 1, 3.0)
    assert row["error"].startswith("ZeroDivisionError: no idea")
    assert row["rollouts"] == 8
    params = PAPER.replace(horizon=4)
    rows = run_shard(Shard(failing, [0, 1, 2], states, params))
    assert [row["outcome"] == "error" for row in rows] == [False, True, False]
    assert [row["intervals"] for row in rows] == [4, 1, 4]
    assert [row["rollouts"] for row in rows] == [32, 8, 32]


def test_policy_that_raises__is_reported_and_the_run_ends_well(
    failing: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = "--tasks random:20:3 --workers 1 --set horizon=4 --out"
    EVALUATE.good(failing, *words.split(), out)
    printed = capsys.readouterr().out
    assert "failing: error on task 1 and 1 more: ZeroDivisionError" in printed
    assert "2 error in phase 1" in printed
    rows = episodes(out)
    assert [int(row["task"]) for row in rows] == list(range(20))
    assert [int(row["task"]) for row in rows if row["outcome"] == "error"] == [1, 12]
    assert rows[12]["error"] == "ZeroDivisionError: no idea, \u00e9 either"
    assert _summary(out)["policies"]["failing"]["outcomes"]["error"] == 2
