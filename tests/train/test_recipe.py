"""``python -m train recipe``: from random weights to models, killed and resumed."""

from __future__ import annotations

import importlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

import snake_env.policies.value
import train.models
from evaluate.protocol import Shard, run_shard
from snake_env import SnakeParams, load_policy
from snake_env.networks.model_file import Model, read_model, write_model
from snake_env.sim.tasks import load_tasks
from tests.support import HANGS_S
from tests.support.commands import Command, names, read_csv
from tests.support.models import same_network
from train.__main__ import main
from train.config import parse_with_file, replaced
from train.models import SOURCES
from train.recipe import ORDER, RECIPES, STAGES, check
from train.records import read_about

TRAIN = Command(main)
TINY = """
expected: half a minute [/red]
value: {generations: 2, episodes: 48, exact: 1, hidden: [12]}
imitate: {rounds: 1, decisions: 2048, hidden: [12], last_epochs: 1, validation_tasks: 3}
ppo: {timesteps: 1024, hidden: [12], critic_hidden: [12], segment: 512, num_envs: 16, n_steps: 16,
      batch_size: 64, ema_rate: 0.1, validation_tasks: 3}
dqn: {timesteps: 512, hidden: [12], segment: 256, num_envs: 16, learning_starts: 64, batch_size: 32,
      validation_tasks: 3}
"""


def _words(folder: Path, out: Path) -> list[str]:
    file = folder / "tiny.yaml"
    file.write_text(TINY)
    words = ["recipe", "--preset", "narrow", "--budget", str(file), "--tasks", "6", "--seed", "3"]
    return [*words, "--workers", "1", "--out", str(out)]


def _bytes(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((out / "models").iterdir())}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recipe")


@pytest.fixture(scope="module")
def finished(folder: Path) -> Path:
    """A recipe that found nothing that ships."""

    def nothing(name: str) -> tuple[()]:
        raise AssertionError(f"{name} was asked for")

    out = folder / "finished"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(snake_env.policies.value, "shipped", nothing)
        assert main(_words(folder, out)) == 0
    return out


def test_recipe__makes_models_that_know_their_recipe(finished: Path) -> None:
    params = SnakeParams.preset("narrow")
    state = load_tasks("random:1:5", params).initial(0, params)
    for name in SOURCES:
        model = read_model(finished / "models" / f"{name}.safetensors")
        assert model.params == params
        assert model.made["seed"] == 3
        assert list(model.made["stages"]) == ["value", "imitate", "ppo", "dqn"]
        assert str(finished) not in json.dumps(dict(model.made))
        assert ("analytic" in model.made["validation"]) is False
        if model.kind == "policy":
            assert model.critic is not None
            assert {name, f"{name}+critic"} == set(model.made["validation"])
            load_policy(f"{finished / 'models' / name}.safetensors+critic", params).select_mode(
                state
            )
    table = json.loads((finished / "models" / "validation.json").read_text())
    assert {"analytic", "value", "ppo", "ppo+critic", "dqn+critic", "imitate"} <= table.keys()
    assert all(row["n"] == 6 for row in table.values())


def test_recipe__each_stage_learns_from_those_before_it(finished: Path) -> None:
    def config(stage: str) -> dict[str, object]:
        config: dict[str, object] = json.loads((finished / stage / "run.json").read_text())[
            "config"
        ]
        return config

    value = read_model(finished / "value" / "value.safetensors").sha256
    student = read_model(finished / "imitate" / "last.safetensors").sha256
    assert config("value")["init"] is None
    assert config("imitate")["value"] == value
    assert [config("ppo")["init"], config("ppo")["init_critic"]] == [student, value]
    assert config("dqn")["init"] == student
    assert {config(stage)["critic"] for stage in ("ppo", "dqn")} == {value}
    assert len(read_csv(finished / "log.csv")) == len(ORDER)


def test_resume__of_a_finished_recipe_changes_nothing(
    folder: Path, finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = _bytes(finished)
    assert main([*_words(folder, finished), "--resume"]) == 0
    assert _bytes(finished) == before
    told = capsys.readouterr().out
    assert "half a minute [/red]\n" in told  # a text, no markup
    assert "ppo+critic" in told
    other = (*_words(folder, finished), "--resume", "--seed", 4)
    assert "differ: seed" in TRAIN.refusal(capsys, *other)


def test_kill__anywhere_and_resume_end_in_the_same_bytes(folder: Path, finished: Path) -> None:
    out = folder / "killed"
    command = [sys.executable, "-m", "train", *_words(folder, out), "--resume"]
    for stage in ("value/returns-0.npz", "imitate/run.json", "ppo/checkpoint.pt"):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
        begun = time.monotonic()
        while process.poll() is None and time.monotonic() - begun < HANGS_S:
            if (out / stage).exists():
                break
            time.sleep(0.01)
        time.sleep(random.Random(stage).uniform(0.0, 0.2))  # anywhere behind it
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        assert (out / stage).exists()
        assert not (out / "models").exists()
    assert main([*_words(folder, out), "--resume"]) == 0
    one, other = _bytes(finished), _bytes(out)
    assert one.keys() == other.keys()
    for name, content in one.items():
        assert content == other[name], name


@pytest.mark.parametrize("calls", [1, 7])
def test_kill__while_the_models_are_made_changes_nothing_either(
    calls: int, folder: Path, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, written = tmp_path / "copy", []
    shutil.copytree(finished, out)
    rows = (out / "log.csv").read_text().splitlines(keepends=True)
    (out / "log.csv").write_text("".join(rows[:-2]))  # moved, two steps before the end
    shutil.rmtree(out / "models")

    def dying(path: Path, model: Model) -> None:
        written.append(path)
        if len(written) == calls + 1:
            raise KeyboardInterrupt
        write_model(path, model)

    monkeypatch.setattr(train.models, "write_model", dying)
    assert main([*_words(folder, out), "--resume"]) == 130
    assert (out / "models").exists()
    assert _bytes(out) != _bytes(finished)
    assert main(["export", str(out), "--into", str(tmp_path / "into")]) == 2
    assert not (tmp_path / "into").exists()
    monkeypatch.undo()
    assert main([*_words(folder, out), "--resume"]) == 0
    assert _bytes(out) == _bytes(finished)
    assert [row.partition(",")[0] for row in (out / "log.csv").read_text().splitlines()] == [
        row.partition(",")[0] for row in rows
    ]


def test_models__are_the_newest_of_their_stages_with_the_critic(finished: Path) -> None:
    critic = read_model(finished / "value" / "value.safetensors")
    for name, source in SOURCES.items():
        made, learned = (
            read_model(finished / path) for path in (f"models/{name}.safetensors", source)
        )
        assert same_network(made.network, learned.network)
        assert made.kind == learned.kind
        if made.kind == "policy":
            assert made.critic is not None
            assert same_network(made.critic.network, critic.network)
    student, ppo = (
        read_model(finished / "models" / f"{n}.safetensors") for n in ("imitate", "ppo")
    )
    assert not same_network(student.network, ppo.network)


def test_table__is_what_evaluation_finds(finished: Path) -> None:
    params = SnakeParams.preset("narrow")
    suite, table = load_tasks("validation-2k", params), finished / "models" / "validation.json"
    states = [suite.initial(task, params) for task in range(6)]
    for name in ("analytic", "dqn+critic", "value"):
        base, plus, rest = name.partition("+")
        file = "analytic" if name == "analytic" else f"{finished}/models/{base}.safetensors"
        rows = run_shard(Shard(f"{file}{plus}{rest}", list(range(6)), states, params))
        row = json.loads(table.read_text())[name]
        assert row["success"] == sum(each["outcome"] == "success" for each in rows)
        decisions = sum(each["intervals"] for each in rows)
        assert row["rollouts_per_decision"] == pytest.approx(
            sum(each["rollouts"] for each in rows) / decisions
        )


@pytest.mark.parametrize("budget", ["quick", "full"])
def test_budgets__have_options_for_every_stage(budget: str) -> None:
    file = RECIPES / f"{budget}.yaml"
    assert "python -m train recipe " in file.read_text()  # says how it is used
    stages = yaml.safe_load(file.read_text())
    assert "minutes on two" in stages.pop("expected")
    assert list(stages) == [stage for stage in STAGES if stage != "models"]
    for stage, given in stages.items():
        options_of = importlib.import_module(f"train.{stage}").Options
        needed = ["--value", "v.safetensors"] if stage == "imitate" else []
        options = parse_with_file(options_of, stage, ["--config", str(file), *needed])
        assert options == replaced(options, given)
        check(options)
    sizes = {tuple(stages[stage]["hidden"]) for stage in ("imitate", "ppo", "dqn")}
    assert len(sizes) == 1  # PPO and DQN begin with the student
    assert stages["ppo"]["critic_hidden"] == stages["value"]["hidden"]


def test_export__ships_a_recipes_models_under_the_robots_name(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    export = ("export", finished, "--into", tmp_path)
    TRAIN.good(*export)
    assert names(tmp_path) == {
        f"{name}-narrow{end}" for name in SOURCES for end in (".md", ".safetensors")
    }
    card = (tmp_path / "ppo-narrow.md").read_text()
    texts = "python -m train recipe --preset narrow", "random weights", "`ppo+critic` ", "narrow"
    assert all(text in card for text in texts)
    assert "--overwrite" in TRAIN.refusal(capsys, *export)
    assert "name = 'mine'" in TRAIN.refusal(capsys, *export, "--name", "mine")


def test_export__into_the_package_ships_what_a_wheel_has_room_for(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    about = {**read_about(finished, "run"), "git": "0123456789"}
    monkeypatch.setattr("train.export.PACKAGE", tmp_path)
    monkeypatch.setattr("train.export.read_about", lambda *of: about)
    into = ["export", str(finished), "--into", os.path.relpath(tmp_path)]  # however it is named
    assert main(into) == 0
    shipped = {path.name for path in tmp_path.glob("*.safetensors")}
    assert shipped == {
        "ppo-narrow.safetensors",
        "dqn-narrow.safetensors",
        "value-narrow.safetensors",
    }
    for name in ("ppo", "dqn"):
        shipped = read_model(tmp_path / f"{name}-narrow.safetensors")
        assert shipped.critic is None  # that of value-narrow serves
        assert shipped.made["git"] == "0123456789"
        made = read_model(finished / "models" / f"{name}.safetensors")
        assert same_network(shipped.network, made.network)
    about["robot"] = "paper"
    assert main(into) == 0
    assert {f"{name}.safetensors" for name in SOURCES} < names(tmp_path)


@pytest.mark.parametrize(
    ("words", "content", "hint"),
    [
        ("--budget fulll", "", "did you mean 'full'"),
        ("--budget mine.yaml", "valu: {}", "did you mean 'value'"),
        ("--budget mine.yaml", "value: 3", "value = 3: expected a mapping"),
        ("--budget mine.yaml", "ppo: {timestep: 3}", "did you mean 'timesteps'"),
        ("--budget mine.yaml", "ppo: {timesteps: many}", "timesteps = 'many': expected an integer"),
        ("--budget nowhere.yaml", "", "No such file"),
        ("--tasks 0", "", "tasks = 0: expected 1 to 2000"),
        ("--preset papr", "", "did you mean 'paper'"),
        ("--budget mine.yaml", "ppo: {timesteps: 0}", "timesteps = 0: expected a positive"),
        ("--budget mine.yaml", "dqn: {ema_rate: 2}", "ema_rate = 2.0: expected a number from 0"),
        ("--budget mine.yaml", "value: {hidden: [0]}", "hidden = (0,): expected one or more"),
        ("--budget mine.yaml", "imitate: {epochs: -1}", "epochs = -1: expected a positive"),
        ("--budget mine.yaml", "expected: 3", "expected = 3: expected a string"),
        ("--budget mine.yaml", "models: {}", "unknown stage in the recipe 'models'"),
        ("--budget mine.yaml", "[value]", "expected a mapping of options to values"),
        ("--workers 0", "", "workers = 0"),
        ("--slip 1 -1", "", "slip"),
    ],
)
def test_bad_input__is_one_line_and_leaves_nothing(
    words: str, content: str, hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text(content)
    assert hint in TRAIN.refusal(capfd, "recipe", *words.split())
    assert names(tmp_path) == {"mine.yaml"}
