"""``python -m evaluate compare``: finished runs against each other, and what it refuses."""

import csv
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from evaluate.__main__ import main
from tests.support.commands import Command
from tests.support.evaluations import episodes

EVALUATE = Command(main)
TASKS = ("--tasks", "random:12:3", "--workers", "1", "--no-pictures")


def _summary(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "summary.json").read_text())


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Finished runs: of one policy each, of both together, of other tasks, robot and slip."""
    folder = tmp_path_factory.mktemp("compare")
    for name, arguments in {
        "a": ("imitate", *TASKS),
        "b": ("random", *TASKS),
        "both": ("imitate", "random", *TASKS, "--no-latency"),
        "tasks": ("random", *TASKS, "--tasks", "random:12:4"),
        "narrow": ("random", *TASKS, "--preset", "narrow"),
        "slippery": ("random", *TASKS, "--slip", "0.01", "0.02"),
    }.items():
        EVALUATE.good(*arguments, "--out", folder / name)
    return folder


@pytest.fixture
def copy(runs: Path, tmp_path: Path) -> Path:
    """A copy of a run, to be damaged."""
    shutil.copytree(runs / "b", tmp_path / "copy")
    return tmp_path / "copy"


def test_comparison_of_folders__is_that_of_one_run(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    EVALUATE.good("compare", runs / "a", runs / "b", "--out", tmp_path / "out")
    printed = capsys.readouterr().out
    here, there = _summary(tmp_path / "out"), _summary(runs / "both")
    for key in ("comparisons", "profiles", "seeds", "tasks", "params", "preset"):
        assert here[key] == there[key]
    for name, run in (("imitate", "a"), ("random", "b")):
        latency = here["policies"][name].pop("decision_latency_us")
        assert latency == _summary(runs / run)["policies"][name]["decision_latency_us"]
        del there["policies"][name]["decision_latency_us"]
    assert here["policies"] == there["policies"]
    episodes = (tmp_path / "out" / "episodes.csv").read_bytes()
    assert episodes == (runs / "both" / "episodes.csv").read_bytes()
    assert here["comparisons"][0]["sentence"] in printed
    assert here["command"] == f"python -m evaluate compare {runs / 'a'} {runs / 'b'}"


def test_policy_in_several_folders__is_named_with_its_folder(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    EVALUATE.good("compare", runs / "both", runs / "b", "--out", out)
    names = ["imitate", f"random ({runs / 'both'})", f"random ({runs / 'b'})"]
    assert list(_summary(out)["policies"]) == names
    assert list(dict.fromkeys(row["policy"] for row in episodes(out))) == names
    EVALUATE.good("compare", out)  # what it writes is a finished run again
    assert f"{names[2]} solves" in capsys.readouterr().out


Damage = Callable[[Path], Any]


def _edited(change: Callable[[dict[str, Any]], Any]) -> Damage:
    """Changes the summary."""

    def damage(folder: Path) -> None:
        summary = _summary(folder)
        change(summary)
        (folder / "summary.json").write_text(json.dumps(summary))

    return damage


def _of_random(**changes: Any) -> Damage:
    """Changes figures of the policy."""
    return _edited(lambda summary: summary["policies"]["random"].update(changes))


def _written(old: str, new: str, name: str = "episodes.csv") -> Damage:
    """Replaces a text in a file."""

    def damage(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return damage


def _latency(**changes: Any) -> Damage:
    """Changes figures of the policy's latencies."""
    return _edited(lambda s: s["policies"]["random"]["decision_latency_us"].update(changes))


def _drop_last_line(folder: Path) -> None:
    path = folder / "episodes.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))


def _closer(folder: Path) -> None:
    """Changes a figure of an episode; the summary stays as it is."""
    rows = episodes(folder)
    rows[0]["d_min"] = "0.001"
    with (folder / "episodes.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


DAMAGES: dict[str, tuple[Damage, str]] = {
    "interrupted": (
        lambda f: (f / "episodes.partial.jsonl").touch(),
        r"expected a finished run \(--resume finishes it\)",
    ),
    "no summary": (
        lambda f: (f / "summary.json").unlink(),
        r"a result folder \(summary\.json: No such file",
    ),
    "no episodes": (
        lambda f: (f / "episodes.csv").unlink(),
        r"a result folder \(episodes\.csv: No such file",
    ),
    "no JSON": (
        lambda f: (f / "summary.json").write_text('{"poli'),
        r"the summary of a run \(invalid JSON",
    ),
    "bytes": (lambda f: (f / "summary.json").write_bytes(b"\xff\x00"), "the summary of a run"),
    "a list": (lambda f: (f / "summary.json").write_text("[]"), "the summary of a run"),
    "foreign": (
        lambda f: (f / "summary.json").write_text('{"accuracy": 1}'),
        r"the summary of a run \(KeyError: 'tasks'\)",
    ),
    "no policies": (_edited(lambda s: s["policies"].clear()), "no policies"),
    "unknown constant": (_edited(lambda s: s["params"].update(mass=3)), "unknown parameter 'mass'"),
    "bad constant": (_edited(lambda s: s["params"].update(n_joints=99)), "n_joints = 99: expected"),
    "success that is none": (
        _of_random(success=11),
        r"\(success of random is 11; its episodes give \d\)",
    ),
    "other columns": (_written("policy,task", "policy,number"), "columns policy, number, outcome"),
    "a word for a number": (_written("random,3,", "random,three,"), r"line 5: task = 'three'"),
    "a number that is too large": (
        _written("random,3,", f"random,{9**30},"),
        r"line 5: task = '\d{28,}'",
    ),
    "no 95th percentile": (
        _edited(lambda s: s["policies"]["random"]["decision_latency_us"].pop("p95")),
        "KeyError: 'p95'",
    ),
    "a slip of one number": (
        _edited(lambda s: s.update(slip=[0.1])),
        "slip = \\[0.1\\]: expected \\(m, rad\\)",
    ),
    "a word for a latency": (_latency(p95="soon"), "p95 is 'soon'"),
    "an endless latency": (
        _written('"p95": ', '"p95": Infinity, "p95.": ', "summary.json"),
        "JSON has no Infinity",
    ),
    "a negative latency": (_latency(p50=-1), "p50 is -1"),
    "a trillion tasks": (
        _edited(lambda s: s["tasks"].update(n=10**12)),
        "one row for each of 1,000,000,000,000 tasks; random has 12 rows",
    ),
    "another rate": (
        _of_random(success_rate=0.99),
        r"success_rate of random is 0\.99; its episodes give 0\.",
    ),
    "another interval": (_of_random(wilson95=[0.9, 1.0]), r"wilson95 of random is \[0\.9, 1\.0\]"),
    "another cost": (
        _of_random(rollouts_per_decision=None),
        "rollouts_per_decision of random is None",
    ),
    "fewer failures": (_of_random(failures_by_phase={}), r"failures_by_phase of random is \{\}"),
    "an episode that went otherwise": (_closer, "d_min of random is"),
    "an unknown outcome": (_written(",success,", ",boredom,"), "outcome = 'boredom'"),
    "an unknown policy": (
        _written("random,3,", "chance,3,"),
        "line 5: policy 'chance' is not in the summary",
    ),
    "a row too few": (_drop_last_line, "one row for each of 12 tasks; random has 11 rows"),
    "a task twice": (_written("random,3,", "random,4,"), "one row for each of 12 tasks"),
    "a torn row": (
        lambda f: (f / "episodes.csv").write_text((f / "episodes.csv").read_text()[:-60]),
        "the episodes of a run",
    ),
    "NUL bytes": (
        lambda f: (f / "episodes.csv").write_bytes(b"\x00\xff" * 99),
        "the episodes of a run",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_folder__is_refused_in_one_line(
    damage: str, runs: Path, copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, message = DAMAGES[damage]
    change(copy)
    told = EVALUATE.refusal(capsys, "compare", runs / "a", copy, "--out", tmp_path / "out")
    assert told.startswith("DIR = ")
    assert "copy" in told
    assert re.search(message, told), told
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("a tasks", r"tasks of .*tasks = 'random:12:4': expected the tasks of .*a, random:12:3"),
        ("a narrow", r"head_contact in .*narrow = False: expected True, as in .*a"),
        (
            "a slippery",
            r"slip in .*slippery = \[0\.01, 0\.02\]: expected \[0\.0, 0\.0\], as in .*a",
        ),
        ("", r"DIR = \(\): expected at least one result folder"),
        ("a a", r"DIR = .*a': expected each folder once"),
        ("a missing", r"DIR = .*missing': expected a result folder"),
        ("a b --overwrite", r"out = None: expected a folder: --overwrite requires --out"),
        ("a b --out b", r"out = .*b': expected none of the folders that are compared"),
    ],
)
def test_folders_that_do_not_fit__are_refused(
    arguments: str, message: str, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [word if word[:1] == "-" else runs / word for word in arguments.split()]
    before = (runs / "b" / "episodes.csv").read_bytes()
    told = EVALUATE.refusal(capsys, "compare", *words)
    assert re.search(message, told), told
    assert (runs / "b" / "episodes.csv").read_bytes() == before
