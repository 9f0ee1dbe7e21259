"""``train export``: what it ships, and what it leaves alone."""

from pathlib import Path

import pytest

from snake_env.networks.model_file import read_model
from tests.support.commands import Command
from train.__main__ import main

TRAIN = Command(main)
RUN = (
    "ppo --timesteps 512 --segment 512 --num-envs 16 --n-steps 16 --batch-size 64 --hidden 8 8 "
    "--validation-tasks 3 --seed 3"
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "run"
    TRAIN.good(*RUN.split(), "--out", out)
    return out


def test_card__says_how_many_tasks_validated_it(run: Path, tmp_path: Path) -> None:
    TRAIN.good("export", run, "--into", tmp_path / "new" / "into")
    card = (tmp_path / "new" / "into" / "ppo.md").read_text()
    assert "on the first 3 of 2,000 tasks of `validation-2k`" in card


@pytest.mark.parametrize("there", ["ppo.safetensors", "ppo.md"])
def test_model_that_is_there__is_replaced_only_when_asked(
    run: Path, tmp_path: Path, there: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / there).write_text("shipped")
    told = TRAIN.refusal(capsys, "export", run, "--into", tmp_path)
    assert f"{there}': expected a new name (or --overwrite to replace the model)" in told
    assert [path.name for path in tmp_path.iterdir()] == [there]
    assert (tmp_path / there).read_text() == "shipped"
    TRAIN.good("export", run, "--into", tmp_path, "--overwrite")
    read_model(tmp_path / "ppo.safetensors")
    TRAIN.good("export", run, "--into", tmp_path, "--name", "other")


@pytest.mark.parametrize("name", ["../evil", "a/b", "", ".hidden", "x" * 61, "a\nb", "a b"])
def test_name__is_that_of_a_file(
    run: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    told = TRAIN.refusal(capsys, "export", run, "--into", tmp_path / "into", f"--name={name}")
    assert told.startswith("name = ")
    assert list(tmp_path.iterdir()) == []
