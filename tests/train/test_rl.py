"""``python -m train ppo`` and ``dqn``: they learn, they resume exactly, they refuse nonsense."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from agents.ppo import SHARPNESS, PPOLearner, Settings
from harness.robot import Robot
from snake_env import SnakeParams, load_policy
from snake_env.networks.model_file import read_model, write_model
from snake_env.networks.symmetry import CanonicalNetwork
from snake_env.sb3 import SnakeVecEnv
from snake_env.sim.observation import observation_size
from tests.support import HANGS_S
from tests.support.commands import Command, names, read_csv
from tests.support.models import model_of, random_network, same_network
from tests.support.robots import random_state
from train.__main__ import main

TRAIN = Command(main)
SMALL = {
    "ppo": "--timesteps 3072 --segment 1024 --num-envs 16 --n-steps 16 --batch-size 64 "
    "--ema-rate 0.3",
    "dqn": "--timesteps 3072 --segment 1024 --num-envs 16 --learning-starts 300 --batch-size 32 "
    "--buffer-size 1600 --target-update 512 --gradient-steps 2",
}
COMMON = "--hidden 24 24 --validation-tasks 6 --validate-every 1 --seed 3"


def arguments(algorithm: str, out: Path, more: str = "") -> list[str]:
    words = f"{algorithm} {SMALL[algorithm]} {COMMON} {more}".split()
    return [*words, "--out", str(out)]


def log(run: Path) -> list[dict[str, str]]:
    return [
        {key: value for key, value in row.items() if key != "frames_per_s"}
        for row in read_csv(run / "log.csv")
    ]


@pytest.fixture(scope="module", params=["ppo", "dqn"])
def finished(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / request.param
    assert main(arguments(request.param, out)) == 0
    return out


def test_run__leaves_models_log_and_curve(finished: Path) -> None:
    kept = {"run.json", "log.csv", "curve.png", "best.safetensors", "last.safetensors"}
    assert kept <= names(finished)
    steps = [int(row["timesteps"]) for row in log(finished)]
    assert steps == sorted(steps)
    assert steps[-1] >= 3072
    figures = {"ppo": ("approx_kl", "explained_variance", "loss"), "dqn": ("loss", "action_value")}
    validated = [row for row in log(finished) if row["raw_success"]]
    assert len(validated) == 3  # one for each segment, and more updates than these
    assert len(log(finished)) > 6
    assert all(row[name] for row in log(finished)[-3:] for name in figures[finished.name])
    assert all(row["critic_rollouts"] for row in validated)
    assert any((finished / "tensorboard").iterdir())
    policy = load_policy(finished / "best.safetensors", SnakeParams())
    assert policy.rollouts == 0


@pytest.mark.parametrize("when", [1, 2])
def test_kill__and_resume_end_as_if_nothing_had_happened(
    when: int, finished: Path, tmp_path: Path
) -> None:
    algorithm, out = finished.name, tmp_path / "killed"
    command = [sys.executable, "-m", "train", *arguments(algorithm, out)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
    deadline = time.monotonic() + HANGS_S
    while process.poll() is None and time.monotonic() < deadline:
        if (out / "log.csv").exists() and sum(
            map(bool, (row["raw_success"] for row in log(out)))
        ) >= when:
            break
        time.sleep(0.01)
    time.sleep(0.05 * when)  # not always at the same place
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert main([*arguments(algorithm, out), "--resume"]) == 0
    assert log(out) == log(finished)
    for name in ("best", "last"):
        one, other = (read_model(run / f"{name}.safetensors") for run in (out, finished))
        assert same_network(one.network, other.network)


def test_seed__decides_everything(finished: Path, tmp_path: Path) -> None:
    algorithm = finished.name
    other = tmp_path / "other"
    assert main([*arguments(algorithm, other), "--seed", "4"]) == 0
    assert log(other) != log(finished)


def test_tasks__are_those_of_the_suite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    phi0 = np.stack([random_state(seed).phi for seed in range(3)])
    suite, seen = tmp_path / "tasks.npz", []
    np.savez(suite, phi0=phi0, target=phi0[::-1])

    class Watched(SnakeVecEnv):
        def reset(self) -> Any:
            observed = super().reset()
            seen.append(self.envs.core.states)
            return observed

    monkeypatch.setattr("train.rl.SnakeVecEnv", Watched)
    out = tmp_path / "run"
    assert main(arguments("ppo", out, f"--tasks {suite} --timesteps 1024")) == 0
    assert json.loads((out / "run.json").read_text())["config"]["tasks"][0] == 3
    (begun,) = seen
    drawn = {tuple(state) for state in begun.phi}
    assert drawn == {tuple(shape) for shape in phi0}  # 16 robots: all three are among them


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        ("ppo --learning-rat 1", "Unrecognized options"),
        ("ppo --timesteps many", "timesteps"),
        ("ppo --timesteps 0", "timesteps = 0: expected a positive"),
        ("ppo --preset papr", "did you mean 'paper'"),
        ("ppo --device gpu", "unknown device 'gpu'"),
        ("ppo --segment 0", "segment = 0"),
        ("ppo --reward tim=1", "did you mean 'time'"),
        ("ppo --reward time", "NAME=VALUE"),
        ("ppo --reward time=1e300", r"reward_weights\['time'\] = 1e\+300"),
        ("dqn --reward gamma=2", r"reward_weights\['gamma'\] = 2"),
        ("dqn --workers 0", "workers = 0"),
        ("ppo --tasks test-10k", "tasks = 'test-10k': expected a suite that is not reserved"),
        ("dqn --tasks validation-2k", "tasks = 'validation-2k': expected a suite that"),
        ("ppo --tasks nowhere.npz", "tasks = 'nowhere.npz': expected a file that exists"),
        ("ppo --set a_d=1", "unknown"),
        ("ppo --validation-tasks 0", "1 to 2000"),
        ("ppo --init nowhere.safetensors", "No such file"),
        ("dqn --hidden", "hidden"),
        ("dqn --seed -1", "seed"),
        ("dqn --seeds 0", "seeds = 0: expected a positive"),
        ("dqn --seeds 1000000000", "seeds = 1000000000: expected .* at most 1000"),
        ("ppo --seed 2147483647 --seeds 2", "seed = 2147483648: expected an integer from 0"),
        ("ppo --seeds 2 --out .", r"out = '\.': expected a folder with a name"),
        ("ppo --seeds 2 --out ..", r"out = '\.\.': expected a folder with a name"),
        ("ppo --seeds 2 --workers 0", "workers = 0"),
        ("dqn --exploration 2", "exploration"),
        ("pppo", "did you mean 'ppo'"),
    ],
)
def test_bad_input__is_one_line_and_leaves_nothing(
    words: str, hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    assert re.search(hint, TRAIN.refusal(capfd, *words.split()))
    assert not names(tmp_path)


def test_folder__of_another_run_is_not_touched(
    finished: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    before = (finished / "log.csv").read_bytes()
    words = arguments(finished.name, finished)
    assert "--resume" in TRAIN.refusal(capfd, *words)
    other = TRAIN.refusal(capfd, *words, "--resume", "--learning-rate", 0.5)
    assert "differ: learning_rate" in other
    about = (finished / "run.json").read_text()
    try:
        (finished / "run.json").write_text(about.replace('"schema": 1', '"schema": 99'))
        assert "schema 1" in TRAIN.refusal(capfd, *words, "--resume")
    finally:
        (finished / "run.json").write_text(about)
    assert (finished / "log.csv").read_bytes() == before


def test_init__of_another_size_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    given = tmp_path / "given.safetensors"
    write_model(given, model_of())
    words = arguments("ppo", tmp_path / "run", f"--init {given}")
    assert "hidden" in TRAIN.refusal(capfd, *words)


def test_init_critic__begins_with_what_the_value_network_says(tmp_path: Path) -> None:
    value = random_network([observation_size(8), 12, 1], 2, 0.3)
    settings = Settings(hidden=(8,), critic_hidden=(12,), num_envs=4, batch_size=32)
    env = SnakeVecEnv(4, mask_in_observation=True, reward_weights={"success": 2.0})
    learner = PPOLearner(settings, env, seed=0, device="cpu")
    learner.begin_critic(value)
    model = learner.model
    env.seed(0)
    observations = env.reset()
    with torch.no_grad():
        critic = model.policy.predict_values(model.policy.obs_to_tensor(observations)[0])
    intervals = CanonicalNetwork(value, 8)(observations["observation"])
    np.testing.assert_allclose(critic.numpy(), 2.0 - 0.1 * intervals, rtol=1e-5, atol=1e-6)
    again = learner.critic(SnakeParams()).network
    for learned, begun in zip(
        [*again.weights, *again.biases], [*value.weights, *value.biases], strict=True
    ):
        np.testing.assert_allclose(learned, begun, rtol=1e-5, atol=1e-5)


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("seeds")
    assert main(arguments("ppo", folder / "ppo", "--seeds 2 --workers 2")) == 0
    return folder


def test_seeds__are_the_runs_that_one_would_make_alone(seeds: Path, tmp_path: Path) -> None:
    folders = {"ppo-s3", "ppo-s4", "ppo-seeds"}
    assert names(seeds) == folders | {"ppo-s3.log", "ppo-s4.log"}
    assert "raw " in (seeds / "ppo-s4.log").read_text()  # what it said on the way
    assert main(arguments("ppo", tmp_path / "alone", "--seed 4")) == 0
    assert log(tmp_path / "alone") == log(seeds / "ppo-s4")
    one, other = (
        read_model(run / "best.safetensors") for run in (tmp_path / "alone", seeds / "ppo-s4")
    )
    assert same_network(one.network, other.network)
    command = json.loads((seeds / "ppo-s4" / "run.json").read_text())["command"]
    assert command.endswith("--seed 4")
    assert "--seeds" not in command
    assert (seeds / "ppo-seeds" / "curve.png").is_file()
    spread = json.loads((seeds / "ppo-seeds" / "seeds.json").read_text())
    assert spread["ppo-s4"] == dict(other.made["validation"])


def test_seeds__begin_each_with_its_own_network(tmp_path: Path) -> None:
    out, given = tmp_path / "ppo", {}
    for seed in (3, 4):
        given[seed] = model_of(seed)
        write_model(tmp_path / f"student-s{seed}.safetensors", given[seed])
        write_model(tmp_path / f"value-s{seed}.safetensors", model_of(seed, kind="value"))
    init, critic = (tmp_path / f"{name}-s{{seed}}.safetensors" for name in ("student", "value"))
    frozen = (
        f"--seeds 2 --workers 1 --timesteps 1024 --critic-warmup 4096 --init {init} --hidden 12"
    )
    assert main(arguments("ppo", out, f"{frozen} --init-critic {critic} --critic-hidden 12")) == 0
    for seed in (3, 4):
        made = read_model(tmp_path / f"ppo-s{seed}" / "last.safetensors")
        assert same_network(
            made.network, given[seed].network.scaled(SHARPNESS)
        )  # only the critic has learned
        config = made.made["config"]
        for name, begun in (("student", "init"), ("value", "init_critic")):
            file = tmp_path / f"{name}-s{seed}.safetensors"
            assert config[begun] == read_model(file).sha256


@pytest.mark.parametrize(
    ("preset", "changes", "name"),
    [
        ("paper", (), "paper"),
        ("narrow", ("n_joints=6", "a_c=67"), "narrow-n_joints=6-a_c=67"),
        ("paper", ("w_d=[0, 0, -1.5]",), "paper-w_d=-0,-0,--1.5-0d24f45c"),
    ],
)
def test_folder__is_named_after_the_robot(preset: str, changes: tuple[str, ...], name: str) -> None:
    assert Robot(preset, changes).name == name


def test_seeds__that_were_killed_go_on(
    seeds: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "ppo"
    shutil.copytree(seeds / "ppo-s3", tmp_path / "ppo-s3")  # the other has not been begun
    assert main(arguments("ppo", out, "--seeds 2 --workers 1 --resume")) == 0
    for name in ("ppo-s3", "ppo-s4"):
        assert log(tmp_path / name) == log(seeds / name)
    told = capfd.readouterr().out
    assert "ppo-s3" in told
    assert "worst" in told
