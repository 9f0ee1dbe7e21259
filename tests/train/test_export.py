"""``train export``: what it ships, and what it leaves alone."""

from pathlib import Path

import pytest

from snake_env.networks.model_file import read_model
from train.__main__ import main

RUN = (
    "ppo --timesteps 512 --segment 512 --num-envs 16 --n-steps 16 --batch-size 64 --hidden 8 8 "
    "--validation-tasks 3 --seed 3"
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "run"
    assert main([*RUN.split(), "--out", str(out)]) == 0
    return out


def _export(run: Path, into: Path, *more: str) -> int:
    return main(["export", str(run), "--into", str(into), *more])


def test_card__says_how_many_tasks_validated_it(run: Path, tmp_path: Path) -> None:
    assert _export(run, tmp_path / "new" / "into") == 0
    card = (tmp_path / "new" / "into" / "ppo.md").read_text()
    assert "on the first 3 of 2,000 tasks of `validation-2k`" in card


@pytest.mark.parametrize("there", ["ppo.safetensors", "ppo.md"])
def test_model_that_is_there__is_replaced_only_when_asked(
    run: Path, tmp_path: Path, there: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / there).write_text("shipped")
    assert _export(run, tmp_path) == 2
    told = capsys.readouterr().err
    assert f"{there}': expected a new name (or --overwrite to replace the model)" in told
    assert [path.name for path in tmp_path.iterdir()] == [there]
    assert (tmp_path / there).read_text() == "shipped"
    assert _export(run, tmp_path, "--overwrite") == 0
    read_model(tmp_path / "ppo.safetensors")
    assert _export(run, tmp_path, "--name", "other") == 0


@pytest.mark.parametrize("name", ["../evil", "a/b", "", ".hidden", "x" * 61, "a\nb", "a b"])
def test_name__is_that_of_a_file(
    run: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _export(run, tmp_path / "into", f"--name={name}") == 2
    assert capsys.readouterr().err.startswith("error: name = ")
    assert list(tmp_path.iterdir()) == []
