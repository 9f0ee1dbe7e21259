"""The benchmarks run: what they print depends on the machine."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks import kernel, results, training, vector
from snake_env.errors import UnknownNameError
from snake_env.sim.tasks import load_tasks
from tests.support import ROOT
from tests.support.robots import PAPER


@pytest.mark.parametrize("measure", [kernel.decision, kernel.loop, kernel.ratios])
def test_kernel__has_a_row_for_each_column(measure: Any) -> None:
    columns, rows = measure(load_tasks("sim-1", PAPER).initial(0, PAPER), PAPER)
    assert rows
    assert all(len(row) == len(columns) for row in rows)


def test_vector__compares_and_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(vector, "_SECONDS", 0.01)
    monkeypatch.setattr(vector, "_TURNS", 1)
    monkeypatch.setattr(vector, "_COUNTS", (2,))
    assert vector.main(["--soak", "1", "--plot", str(tmp_path / "speed.png")]) == 0
    told = capsys.readouterr().out
    assert "SyncVectorEnv" in told
    assert "peak memory" in told
    assert (tmp_path / "speed.png").stat().st_size > 0


def test_training__compares_with_the_ceiling(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    small = training.Settings(num_envs=4, n_steps=4, batch_size=8, hidden=(8,))
    monkeypatch.setattr(training, "Settings", lambda: small)
    assert training.main(["--rounds", "1"]) == 0
    told = capsys.readouterr().out
    assert "PPO, 4 robots, hidden (8,)" in told
    assert "ceiling" in told


def test_results__are_written_from_the_figures_in_the_documentations_data() -> None:
    page = results.page()
    assert results.PAGE.read_text(encoding="utf-8") == page
    for name in results.EVALUATIONS:
        file = results.DATA / f"{name}.json"
        if not file.exists():
            continue
        data = json.loads(file.read_text(encoding="utf-8"))
        for row in data["policies"].values():
            assert f"{100 * row['success_rate']:.2f}" in page or name == "experiment"
            assert row["success_rate"] == row["success"] / row["n"]


def test_results__have_no_violation_by_a_policy_that_simulates_its_choice() -> None:
    """But for states whose feasible modes all let links touch, which two episodes of 130,000 meet."""
    checked = {}
    for name in results.EVALUATIONS:
        policies = json.loads((results.DATA / f"{name}.json").read_text())["policies"]
        for policy, row in policies.items():
            if policy.partition(":")[0] in ("analytic", "value", "lookahead") or "+" in policy:
                assert row["violations"] <= (2 if (name, policy) == ("hardware", "value") else 0)
                checked[name, policy] = row["n"]
    assert {checked["paper", f"{learner}+critic"] for learner in ("ppo", "dqn")} == {10_000}


def test_results__are_of_the_networks_that_ship() -> None:
    files = (ROOT / "snake_env" / "pretrained").glob("*.safetensors")
    digests = {hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    for name in results.EVALUATIONS:
        models = json.loads((results.DATA / f"{name}.json").read_text())["models"]
        assert models["analytic"] == []
        assert models["ppo+critic"]
        assert {digest for own in models.values() for digest in own} <= digests, name


def test_results__refuse_parts_that_do_not_exist() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'narrow'"):
        results.main(["--run", "--only", "narow"])
