"""Checkpoints: damage and foreign ones are noticed; models are there at each of them, and at Ctrl-C."""

import hashlib
import io
import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from agents.learner import Learner
from harness.engine import Engine
from snake_env import SnakeParams, load_policy
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import read_model
from tests.support.commands import Interrupted, read_csv, tree
from tests.support.damage import PickleBomb, damaged
from train import rl
from train.__main__ import main
from train.checkpoint import check_counters, load_checkpoint, save_checkpoint
from train.run import RunFolder

PPO = (
    "ppo --timesteps 1536 --segment 512 --num-envs 16 --n-steps 16 --batch-size 64 --hidden 8 8 "
    "--validation-tasks 2 --validate-every 2 --seed 3"
)
DQN = (
    "dqn --timesteps 1536 --segment 512 --num-envs 16 --learning-starts 300 --batch-size 32 "
    "--buffer-size 800 --gradient-steps 1 --hidden 8 --validation-tasks 2 --validate-every 2"
)
VALUE = "value --set n_joints=5 --generations 2 --episodes 20 --hidden 8 --epochs 1 --workers 1"


def _run(words: str, out: Path, *more: str) -> int:
    return main([*words.split(), "--out", str(out), *more])


def _interrupted(words: str, out: Path, after: int, *more: str) -> None:
    """Runs until Ctrl-C in the segment after so many."""
    done, learn = [], Learner.learn

    def segment(*args: Any) -> None:
        if len(done) == after:
            raise KeyboardInterrupt
        done.append(None)
        learn(*args)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Learner, "learn", segment)
        assert _run(words, out, *more) == 130


@pytest.fixture(scope="module", params=[PPO, DQN], ids=["ppo", "dqn"])
def begun(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A run that was interrupted after its first segment; and its words."""
    out = tmp_path_factory.mktemp("begun") / "run"
    _interrupted(request.param, out, 1)
    return out, request.param


@pytest.fixture(scope="module")
def begun_dqn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("begun") / "dqn"
    _interrupted(DQN, out, 1)
    return out


@pytest.mark.parametrize("after", [0, 1])
def test_interrupt__leaves_a_model(tmp_path: Path, after: int) -> None:
    out = tmp_path / "run"
    _interrupted(PPO, out, after)
    assert (out / "checkpoint.pt").exists() == (after > 0)
    assert (out / "best.safetensors").exists() == (after > 0)  # the first segment is validated
    model = read_model(out / "last.safetensors")
    assert model.made["timesteps"] == 512 * after
    load_policy(out / "last.safetensors", SnakeParams())


def test_validation__is_of_the_first_segment_then_of_every_so_many(tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert _run(PPO, out, "--timesteps", "2560", "--validate-every", "3") == 0
    rows = read_csv(out / "log.csv")
    assert [int(row["timesteps"]) for row in rows] == list(range(256, 2561, 256))  # every update
    validated = [int(row["timesteps"]) for row in rows if row["raw_success"]]
    assert validated == [512, 1536, 2560]
    assert all(row["approx_kl"] and row["loss"] and row["entropy_loss"] for row in rows)
    assert {"clip_fraction", "explained_variance", "critic_success", "critic_time_s"} <= set(
        rows[0]
    )
    found = read_model(out / "last.safetensors").made["validation"]
    assert found.keys() == {name for name in rows[0] if name.startswith(("raw_", "critic_"))}
    assert {name: f"{value}" for name, value in found.items()} == {
        name: rows[-1][name] for name in found
    }


def _copy(begun: tuple[Path, str], tmp_path: Path) -> tuple[Path, str]:
    out = tmp_path / "copy"
    shutil.copytree(begun[0], out)
    return out, begun[1]


def _refusal(words: str, out: Path, capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    assert _run(words, out, "--resume") == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    return told


@pytest.mark.parametrize("at", [0.001, 0.3, 0.6, 0.999])
def test_flipped_bit__is_noticed(
    begun: tuple[Path, str], tmp_path: Path, at: float, capsys: pytest.CaptureFixture[str]
) -> None:
    out, words = _copy(begun, tmp_path)
    path = out / "checkpoint.pt"
    data = bytearray(path.read_bytes())
    data[int(at * len(data))] ^= 1
    path.write_bytes(data)
    assert "expected an undamaged checkpoint" in _refusal(words, out, capsys)


def _recast(path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Changes the state in a checkpoint; the digest is right again."""
    with io.BytesIO(path.read_bytes()[-_length(path) :]) as file:
        state = torch.load(file, weights_only=True)
    change(state)
    save_checkpoint(path, state)


def _length(path: Path) -> int:
    return path.stat().st_size - len(b"snake-mode-env checkpoint 1\n") - 32


FOREIGN: dict[str, Callable[[dict[str, Any]], Any]] = {
    "another run": lambda s: s.update(run="another"),
    "no run": lambda s: s.pop("run"),
    "no policy": lambda s: s.pop("policy"),
    "an empty policy": lambda s: s.update(policy={}),
    "another network": lambda s: s["policy"].update({"extra.weight": torch.zeros(3)}),
    "no optimizer": lambda s: s.update(optimizer=3),
    "no mean": lambda s: s.pop("mean"),
    "an empty mean": lambda s: s.update(mean={}),
    "no counters": lambda s: s.pop("n_updates"),
    "segments before the beginning": lambda s: s.update(segment=-1),
    "no segment": lambda s: s.update(segment=0),
    "many segments": lambda s: s.update(segment=10**9),
    "few decisions": lambda s: s.update(num_timesteps=3),
    "many decisions": lambda s: s.update(num_timesteps=10**12),
    "half a decision": lambda s: s.update(num_timesteps=512.5),
    "updates before the beginning": lambda s: s.update(n_updates=-1),
    "a truth value": lambda s: s.update(segment=True),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_foreign_state__is_refused(
    begun: tuple[Path, str], tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out, words = _copy(begun, tmp_path)
    _recast(out / "checkpoint.pt", FOREIGN[case])
    assert _refusal(words, out, capsys).startswith("error: checkpoint = ")


def test_checkpoint_of_another_run__is_refused(
    begun: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, words = _copy(begun, tmp_path)
    other = tmp_path / "other"
    _interrupted(words, other, 1, "--seed", "9")
    shutil.copy(other / "checkpoint.pt", out)
    assert "expected a checkpoint of this run" in _refusal(words, out, capsys)


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_bytes__are_a_checkpoint_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, {"run": "a", "policy": {"weight": torch.zeros(3)}, "segment": 1})
    good = path.read_bytes()
    path.write_bytes(damaged(good, data))
    if path.read_bytes() != good:
        with pytest.raises(InvalidInputError, match=r"checkpoint\.pt"):
            load_checkpoint(path, "a", "cpu")
    else:
        assert load_checkpoint(path, "a", "cpu")["segment"] == 1


BUFFER: dict[str, Callable[[dict[str, Any]], Any]] = {
    "no rewards": lambda s: s.pop("rewards"),
    "few rewards": lambda s: s.update(rewards=s["rewards"][:-1]),
    "half a position": lambda s: s.update(pos=1.5),
    "a far position": lambda s: s.update(pos=10**6),
    "fuller than full": lambda s: s.update(full=2),
    "calls before the beginning": lambda s: s.update(calls=-1),
    "no calls": lambda s: s.pop("calls"),
    "an anchor of nothing": lambda s: s.update(anchor={}),
}


@pytest.mark.parametrize("case", BUFFER)
def test_foreign_replay_buffer__is_refused(
    begun_dqn: Path, tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out, words = _copy((begun_dqn, DQN), tmp_path)
    _recast(out / "checkpoint.pt", BUFFER[case])
    assert _refusal(words, out, capsys).startswith("error: checkpoint = ")


@given(st.integers(), st.integers(), st.integers())
def test_counters__that_a_run_cannot_have_are_refused(
    segments: int, decisions: int, updates: int
) -> None:
    state = {"segment": segments, "num_timesteps": decisions, "n_updates": updates}
    try:
        check_counters(Path("x"), state, 1536, 512, 256)
    except InvalidInputError:
        return
    assert 1 <= segments <= 3
    assert 512 * segments <= decisions < 768 * segments
    assert updates >= 0


def test_checkpoint__is_never_unpickled(tmp_path: Path) -> None:
    content = pickle.dumps({"run": "a", "bomb": PickleBomb(tmp_path / "trace")})
    head = b"snake-mode-env checkpoint 1\n" + hashlib.sha256(content).digest()
    (tmp_path / "a.pt").write_bytes(head + content)
    with pytest.raises(InvalidInputError):
        load_checkpoint(tmp_path / "a.pt", "a", "cpu")
    assert not (tmp_path / "trace").exists()


def _points(out: Path, name: str) -> list[int]:
    board = EventAccumulator(str(out / "tensorboard"))
    board.Reload()
    return [event.step for event in board.Scalars(name)]


def test_tensorboard__keeps_every_point_over_a_resume(tmp_path: Path) -> None:
    out = tmp_path / "run"
    _interrupted(PPO, out, 2)
    assert _run(PPO, out, "--resume") == 0
    updates = list(range(256, 1537, 256))
    points = {"train_return": [512, 1024, 1536], "approx_kl": updates, "loss": updates}
    points |= {"raw_success": [512, 1024, 1536], "critic_rollouts": [512, 1024, 1536]}
    for name, steps in points.items():
        assert _points(out, f"ppo/{name}") == steps, name
    assert _run(PPO, out, "--overwrite") == 0
    for name, steps in points.items():
        assert _points(out, f"ppo/{name}") == steps, name
    assert len(list((out / "tensorboard").iterdir())) == 1


def _lasting(out: Path) -> dict[str, bytes]:
    """What a run leaves, but for TensorBoard's files: each session begins another."""
    return {path: content for path, content in tree(out).items() if "/tensorboard" not in path}


@pytest.mark.parametrize("words", [PPO, VALUE], ids=["ppo", "value"])
def test_resume__is_idempotent(
    tmp_path: Path, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert _run(words, out, "--resume") == 0  # begins
    before = _lasting(out)
    capsys.readouterr()
    (out / ".snake-env-abc123_9.tmp").write_text("half a file")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Engine, "map", Interrupted(0))
        assert _run(words, out, "--resume") == 0  # is finished
    assert "this run is finished\n" in capsys.readouterr().out
    assert _lasting(out) == before


@pytest.mark.parametrize("words", [PPO, DQN, VALUE], ids=["ppo", "dqn", "value"])
def test_diverged_run__names_the_rate(
    tmp_path: Path, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(words, tmp_path / "run", "--learning-rate", "1e30") == 2
    told = capsys.readouterr().err.splitlines()
    assert told[-1] == "error: training diverged: lower --learning-rate (1e+30)"


DAMAGES = {
    "": "run.json",
    "[]": "run.json",
    "{}": "run.json",
    "null": "run.json",
    '{"schema": 1}': "run.json",
    '{"schema": 1, "config": null}': "run.json",
    '{"schema": 1, "algorithm": "ppo", "command": "", "config": {}, "versions": {}}': "run.json",
    "[" * 100_000: "run.json",
    "timesteps\nmany\n": "log.csv",
    "timesteps\n512,3\n": "log.csv",
    "timesteps\n512\n512\n": "log.csv",
    "round\n1\n": "log.csv",
    "\0\udcff": "log.csv",
    'timesteps\n"512': "log.csv",
}


@pytest.mark.parametrize("content", DAMAGES, ids=range(len(DAMAGES)))
def test_damaged_run_folder__is_refused(
    begun: tuple[Path, str], tmp_path: Path, content: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out, words = _copy(begun, tmp_path)
    (out / DAMAGES[content]).write_text(content, errors="surrogateescape")
    assert _is_about(_refusal(words, out, capsys), DAMAGES[content])
    if DAMAGES[content] == "run.json":
        assert main(["export", str(out), "--into", str(tmp_path)]) == 2
        assert capsys.readouterr().err.startswith("error: run = ")


def _is_about(told: str, name: str) -> bool:
    return told.startswith("error: log = " if name == "log.csv" else "error: resume = ")


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_run_folder__is_resumed_or_refused(
    begun: tuple[Path, str], tmp_path: Path, data: st.DataObject
) -> None:
    """What is in ``run.json`` and ``log.csv`` decides nothing but whether it is the same run."""
    out = tmp_path / "copy"
    shutil.copytree(begun[0], out, dirs_exist_ok=True)
    config = json.loads((out / "run.json").read_text())["config"]
    name = data.draw(st.sampled_from(["run.json", "log.csv"]))
    (out / name).write_bytes(damaged((out / name).read_bytes(), data))
    run = rl.Run(out=out, resume=True, seed=config["seed"])
    try:
        with RunFolder(run, "ppo", rl.Robot(), config) as folder:
            rows = folder.rows("timesteps")
    except InvalidInputError as error:
        told = str(error)
    else:
        told = ""
        assert all(float(row["timesteps"]) > 0 for row in rows)
    assert "\n" not in told


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04", b"\0" * 100])
def test_damaged_returns__are_refused(
    tmp_path: Path, damage: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    out, words = tmp_path / "run", VALUE.replace("--generations 2", "--generations 3")
    pieces = []

    def work(engine: Engine, call: Any, shards: Any) -> Any:
        for shard in shards:
            if len(pieces) == 2:
                raise KeyboardInterrupt
            pieces.append(None)
            yield call(shard)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Engine, "map", work)
        assert _run(words, out) == 130
    (out / "returns-1.npz").write_bytes(damage)
    assert _refusal(words, out, capsys).startswith("error: returns = ")


def test_seeds__print_names_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Names of folders are no markup, in the workers neither."""
    out = tmp_path / "a[/red]"
    assert _run(PPO, out, "--seeds", "2", "--workers", "1") == 0
    printed = capsys.readouterr().out
    assert f"{out}-s3: done" in printed
    assert (tmp_path / "a[/red]-seeds" / "curve.png").exists()
