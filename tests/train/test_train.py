"""``python -m train``: what value makes, refuses and survives."""

import json
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import train.recipe
import train.run
import train.value
from harness.engine import Engine
from harness.folder import Layout, held
from snake_env.networks.model_file import read_model
from snake_env.policies.value import NetworkValue
from snake_env.sim.observation import observation_size
from tests.support import ROOT
from tests.support.commands import QUICK, Command, Interrupted, names, read_csv, tree
from tests.support.models import same_network
from tests.support.robots import FIVE
from tests.support.torch_threads import one_thread
from train.__main__ import COMMANDS, main

TRAIN = Command(main)
IMITATE = ROOT / "snake_env" / "pretrained" / "imitate.safetensors"
VALUE = ("value", "--generations", "2", "--episodes", "40", "--hidden", "8", *QUICK, "--out")


@pytest.fixture(autouse=True, scope="module")
def _one_thread() -> Iterator[None]:
    with one_thread():
        yield


# the command line


@pytest.mark.parametrize("arguments", [(), ("-h",), ("--help",)])
def test_help__names_every_command(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert TRAIN.run(*arguments) == (0 if arguments else 2)
    stdout, stderr = capsys.readouterr()
    assert stderr == ""
    assert stdout.startswith("usage: python -m train COMMAND [options]\n")
    for name, what in COMMANDS.items():
        assert re.search(rf"^  {name} +{re.escape(what)}$", stdout, re.MULTILINE)


@pytest.mark.parametrize("command", ["value", "imitate"])
def test_help__of_a_command_names_its_options(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert TRAIN.run(command, "--help") == 0
    text = capsys.readouterr().out
    assert f"usage: python -m train {command}" in text
    for option in ("--out DIR", "--set NAME=VALUE", "--preset STR", "--workers INT"):
        assert option in text
    about = text[: text.index("-h, --help")].splitlines()[1:-2]
    assert not [line for line in about[:-1] if line.startswith("  ")]


BAD = {
    "vlaue": r"^unknown command 'vlaue': did you mean 'value'\? known: .*value",
    "--seed 3": r"^unknown command '--seed'",
    "imitate --value {value} --oversampling 0.5": r"^oversampling = 0\.5: expected at least 1$",
    "imitate --value {tmp}/none.safetensors": r"^model = .*none\.safetensors'.*No such file",
    "imitate --value {value} --rounds 0": r"^rounds = 0: expected a positive number$",
    "value --config {tmp}/none.yaml": r"^config = .*none\.yaml",
    "imitate --value {value} --lessons x": r"Unrecognized options: --lessons, x",
    "value --generations 0": r"^generations = 0: expected a positive number$",
    "value --episodes -3": r"^episodes = -3: expected a positive number$",
    "value --trace-decay 1.5": r"^trace_decay = 1\.5: expected a number from 0 to 1$",
    "value --exact -1": r"^exact = -1: expected zero or a positive number$",
    "value --device tpu": r"device 'tpu'",
    "value --window 0": r"^window = 0: expected a positive number$",
    "value --epochs 0": r"^epochs = 0: expected a positive number$",
    "value --batch-size 0": r"^batch_size = 0: expected a positive number$",
    "value --learning-rate 0": r"^learning_rate = 0\.0: expected a positive number$",
    "value --learning-rate nan": r"^learning_rate = nan: expected a positive number$",
    "imitate --value {value} --weight-decay -1": r"^weight_decay = -1\.0: expected zero or a pos",
    "imitate --value {value} --values -1": r"^values = -1\.0: expected zero or a positive number$",
    "value --weight-decay -1": r"^weight_decay = -1\.0: expected zero or a positive number$",
    "value --hidden 8 0": r"^hidden = \(8, 0\): expected one or more positive sizes$",
    "value --hidden": r"hidden",
    "value --seed -1": r"seed = -1: expected an integer from 0",
    "value --overwrite --resume": r"^overwrite = True: expected one of --overwrite and --resume$",
    "value --address here": r"^address = 'here': expected none without --engine ray$",
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input__is_refused_in_one_line_and_nothing_is_written(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    models = {name: str(IMITATE.with_stem(name)) for name in ("imitate", "value")}
    arguments = [word.format(tmp=tmp_path, **models) for word in case.split()]
    out = () if case.startswith(("vlaue", "--seed")) else ("--out", tmp_path / "out")
    assert re.search(BAD[case], TRAIN.refusal(capsys, *arguments[:1], *out, *arguments[1:]))
    assert tree(tmp_path) == {}


def test_process__works_and_ends_with_2_where_it_cannot(tmp_path: Path) -> None:
    once = (*VALUE, tmp_path / "out", "--generations", 1, "--episodes", 8)
    done = TRAIN.process(*once, COLUMNS="40")
    assert f"model: {tmp_path}/out/value.safetensors\n" in done.stdout
    about = json.loads((tmp_path / "out" / "run.json").read_text())
    assert about["command"].startswith("python -m train value --generations 2 --episodes 40")
    done = TRAIN.process("vlaue", code=2, COLUMNS="40")
    assert done.stdout == ""
    assert done.stderr.startswith("error: unknown command 'vlaue': did you mean 'value'?")
    assert done.stderr.count("\n") == 1


# value


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uninterrupted run of two generations."""
    folder = tmp_path_factory.mktemp("learned") / "run"
    TRAIN.good(*VALUE, folder)
    return folder


def _assert_same_run(folder: Path, other: Path, stale: Iterable[str] = ()) -> None:
    one, two = (read_model(path / "value.safetensors").network for path in (folder, other))
    assert same_network(one, two)
    assert (folder / "log.csv").read_bytes() == (other / "log.csv").read_bytes()
    assert names(folder) - set(stale) == names(other)


def test_value__learns_a_network_that_can_be_used(learned: Path) -> None:
    model = read_model(learned / "value.safetensors")
    assert (model.kind, model.params.n_joints) == ("value", 5)
    assert model.network.sizes == [observation_size(5), 8, 1]
    assert model.made["generations"] == 2
    NetworkValue(model, FIVE)
    rows = read_csv(learned / "log.csv")
    assert [row["generation"] for row in rows] == ["1", "2"]
    for row in rows:
        assert 0.0 <= float(row["success"]) <= 1.0
        assert 0.0 < float(row["fit_error"]) < 30.0


def test_value__plays_other_tasks_in_each_generation(learned: Path) -> None:
    targets = []
    for generation in range(2):
        with np.load(learned / f"returns-{generation}.npz") as file:
            assert file["observations"].shape == (len(file["intervals"]), observation_size(5))
            targets.append({row.tobytes() for row in file["observations"][:, 5:10]})
    assert all(10 <= len(each) <= 40 for each in targets)
    assert not targets[0] & targets[1]


def test_value__writes_down_how_it_was_made(learned: Path) -> None:
    about = json.loads((learned / "run.json").read_text())
    assert about["schema"] == 1
    assert about["config"]["hidden"] == [8]
    assert about["config"]["params"]["n_joints"] == 5
    assert {"command", "git", "python", "versions", "machine"} <= about.keys()
    assert read_model(learned / "value.safetensors").made["config"] == about["config"]


def test_value__is_reproducible_and_decided_by_its_seed(learned: Path, tmp_path: Path) -> None:
    TRAIN.good(*VALUE, tmp_path / "again")
    _assert_same_run(tmp_path / "again", learned)
    TRAIN.good(*VALUE, tmp_path / "other", "--seed", 1)
    one, other = (read_model(path / "value.safetensors") for path in (learned, tmp_path / "other"))
    assert not np.array_equal(one.network.weights[0], other.network.weights[0])


def test_value__goes_on_from_a_network_of_the_same_size(learned: Path, tmp_path: Path) -> None:
    begun = read_model(learned / "value.safetensors").network
    slow = ("--init", learned / "value.safetensors", "--learning-rate", 1e-9, "--generations", 1)
    TRAIN.good(*VALUE, tmp_path / "same", *slow)
    TRAIN.good(*VALUE, tmp_path / "other", *slow, "--hidden", 9)
    same = read_model(tmp_path / "same" / "value.safetensors").network
    np.testing.assert_allclose(same.weights[0], begun.weights[0], atol=1e-6)
    other = read_model(tmp_path / "other" / "value.safetensors").network
    assert other.sizes == [observation_size(5), 9, 1]


def _returns(folder: Path, generation: int) -> np.ndarray:
    with np.load(folder / f"returns-{generation}.npz") as file:
        intervals: np.ndarray = file["intervals"]
    return intervals


def test_value__learns_from_exact_returns_first(learned: Path, tmp_path: Path) -> None:
    assert (train.value.Options().trace_decay, train.value.Options().exact) == (0.7, 4)
    for exact in (0, 1):
        TRAIN.good(*VALUE, tmp_path / f"{exact}", "--exact", exact)
        for generation in range(2):
            intervals = _returns(tmp_path / f"{exact}", generation)
            whole = np.array_equal(intervals, np.round(intervals))
            assert whole == (generation < exact)
    np.testing.assert_array_equal(_returns(tmp_path / "1", 0), _returns(learned, 0))
    TRAIN.good(*VALUE, tmp_path / "less", "--exact", 1, "--trace-decay", 0.5)
    np.testing.assert_array_equal(_returns(tmp_path / "less", 0), _returns(learned, 0))
    assert not np.array_equal(_returns(tmp_path / "less", 1), _returns(tmp_path / "1", 1))


class _Kill(BaseException):
    """Ends a run on the spot, as SIGKILL does."""


def _killing(function: Callable[..., Any], calls: int, before: bool) -> Callable[..., Any]:
    """The function, whose call of this number kills before or after it has done its work."""
    made = 0

    def killing(*arguments: Any, **options: Any) -> Any:
        nonlocal made
        made += 1
        if made == calls and before:
            raise _Kill
        result = function(*arguments, **options)
        if made == calls:
            raise _Kill
        return result

    return killing


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize(
    ("where", "name", "calls"),
    [
        (train.value, "fit", 1),
        (train.value.RunFolder, "write_rows", 1),
        (train.value.np, "savez", 2),
        (train.value, "fit", 2),
        (train.value, "write_model", 2),
        (train.value.RunFolder, "write_rows", 2),
        (train.value, "write_model", 3),
    ],
)
def test_value__that_is_killed_resumes_as_if_nothing_had_happened(
    where: Any, name: str, calls: int, before: bool, learned: Path, tmp_path: Path
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(where, name, _killing(getattr(where, name), calls, before))
        with pytest.raises(_Kill):
            TRAIN.run(*VALUE, tmp_path)
    TRAIN.good(*VALUE, tmp_path, "--resume")
    _assert_same_run(tmp_path, learned, stale={"value-0.safetensors"})


@pytest.mark.parametrize("after", [0, 1])
def test_value__that_is_interrupted_resumes_as_if_nothing_had_happened(
    after: int, learned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    TRAIN.interrupt(after, *VALUE, tmp_path)
    assert capsys.readouterr().err == "interrupted; finished work is saved\n"
    assert not (tmp_path / "value.safetensors").exists()
    with pytest.MonkeyPatch.context() as patch:
        engine = Interrupted(2 - after)
        patch.setattr(Engine, "map", engine)
        TRAIN.good(*VALUE, tmp_path, "--resume")
        assert engine.left == 0
    _assert_same_run(tmp_path, learned)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (("--hidden", "9"), "hidden"),
        (("--seed", "1"), "seed"),
        (("--generations", "3"), "generations"),
        (("--episodes", "41", "--epochs", "5"), "episodes, epochs"),
        (("--preset", "narrow"), "params"),
    ],
)
def test_value__resumes_the_same_run_only(
    changes: tuple[str, ...], named: str, learned: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = tree(learned)
    told = TRAIN.refusal(capsys, *VALUE, learned, *changes, "--resume")
    assert told.startswith("resume = ")
    expected = ", ".join(sorted(named.split(", ")))
    assert told.endswith(f"a run with the same options (these differ: {expected})")
    assert tree(learned) == before


def test_value__keeps_a_run_unless_told_otherwise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    once = (*VALUE, tmp_path, "--generations", 1, "--episodes", 8)
    TRAIN.good(*once)
    before = tree(tmp_path)
    told = TRAIN.refusal(capsys, *once)
    assert told.endswith(
        "expected an empty folder (or --overwrite to replace what is there, or --resume)"
    )
    assert tree(tmp_path) == before
    TRAIN.good(*once, "--overwrite", "--seed", 5)
    assert json.loads((tmp_path / "run.json").read_text())["config"]["seed"] == 5
    assert names(tmp_path) == {Path(name).name for name in before}


def test_value__reports_a_damaged_model(
    learned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in learned.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    kept = tmp_path / "value-1.safetensors"
    kept.write_bytes(kept.read_bytes()[:-1])
    assert "a safetensors file" in TRAIN.refusal(capsys, *VALUE, tmp_path, "--resume")


@pytest.mark.parametrize("layout", [train.run.LAYOUT, train.recipe.LAYOUT])
def test_overwrite__leaves_the_users_own_files_alone(tmp_path: Path, layout: Layout) -> None:
    theirs = {"tasks.npz", "mine.csv", "mine.safetensors", "notes.json", "mine.log"}
    ours = {"run.json", "log.csv"}
    for name in theirs | ours:
        (tmp_path / name).touch()
    with held(tmp_path, layout, overwrite=True):
        assert names(tmp_path) == theirs
