"""Imitation of a teacher's costs, and what becomes of its models."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from agents.imitate import Fit, dataset, fit
from agents.labels import Decisions
from agents.teacher import label
from snake_env import SnakeParams, load_policy
from snake_env.networks.model_file import REWARD_PER_LOGIT, Model, read_model, write_model
from snake_env.networks.network import Network
from snake_env.networks.symmetry import SymmetricNetwork
from snake_env.policies.value import PhaseValue, pretrained
from snake_env.sim.observation import observe
from snake_env.sim.tasks import load_tasks
from snake_env.state import StateBatch
from tests.support.commands import Command, read_csv
from tests.support.models import same_network
from train.__main__ import main

TRAIN = Command(main)
PARAMS = SnakeParams()
SMALL = (
    "--rounds 2 --decisions 4096 --hidden 64 64 --epochs 8 --last-epochs 8 --batch-size 256 "
    "--learning-rate 0.003 "
    "--validation-tasks 12 --workers 1 --seed 5"
)


@pytest.fixture(scope="module")
def decisions() -> Decisions:
    suite = load_tasks("random:24:8", PARAMS)
    states = StateBatch.initial(suite.phi0, suite.target, PARAMS)
    return label(states, PhaseValue(PARAMS), PARAMS)


def test_decisions__are_costs_of_what_the_mask_allows(decisions: Decisions) -> None:
    data = dataset(decisions, PARAMS)
    for k in range(len(data.cost)):
        cost = data.cost[k].astype(np.float64)
        mask, feasible = decisions.mask[k], decisions.feasible[k]
        assert (cost[~mask] == -1.0).all()
        assert np.isinf(cost[mask & ~feasible]).all()
        wanted = decisions.cost_to_go[k][mask & feasible]
        np.testing.assert_allclose(cost[mask & feasible], wanted, atol=0.01)
    np.testing.assert_array_equal(data.observations, observe(decisions.states, PARAMS))


def test_decisions__leave_out_deadlocks(decisions: Decisions) -> None:
    stuck = Decisions(
        decisions.states,
        decisions.mask,
        decisions.feasible & (np.arange(24) != 7)[:, None],
        np.where((np.arange(24) != 7)[:, None], decisions.cost_to_go, np.float32(np.inf)),
    )
    assert len(dataset(stuck, PARAMS).cost) == 23


def test_fit__lowers_the_regret_of_the_preferred_mode(decisions: Decisions) -> None:
    data = dataset(decisions, PARAMS)
    how = Fit(hidden=(64,), epochs=1, batch_size=24)
    first, before = fit(None, [data], how, PARAMS, seed=0, last=False)
    network: Network = first
    how = dataclasses.replace(how, epochs=400, learning_rate=3e-3)
    network, after = fit(network, [data], how, PARAMS, seed=1, last=False)
    assert after["regret"] + after["infeasible"] < 0.3 * (before["regret"] + before["infeasible"])


def test_fit__is_decided_by_the_seed(decisions: Decisions) -> None:
    data = dataset(decisions, PARAMS)
    how = Fit(hidden=(8,), last_epochs=2, batch_size=8)
    one, other, third = (
        fit(None, [data], how, PARAMS, seed=seed, last=True)[0] for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(one.weights[0], other.weights[0])
    assert not np.array_equal(one.weights[0], third.weights[0])


def test_fit__learns_the_return_of_every_mode(decisions: Decisions) -> None:
    data = dataset(decisions, PARAMS)
    how = Fit(hidden=(128,), epochs=300, batch_size=24, learning_rate=3e-3, values=100.0)
    network, _ = fit(None, [data], how, PARAMS, seed=0, last=False)
    estimates = REWARD_PER_LOGIT * SymmetricNetwork(network, 8)(data.observations)
    good = data.cost.min(axis=1, where=data.cost >= 0.0, initial=np.inf)[:, None] + 1.0
    near = (data.cost >= 0.0) & (data.cost <= good)
    wanted = 1.0 - 0.1 * data.cost[near].astype(np.float64)
    assert np.abs(estimates[near] - wanted).mean() < 0.05


def log(run: Path) -> list[dict[str, str]]:
    return read_csv(run / "log.csv")


@pytest.fixture(scope="module")
def value(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a value network that knows something."""
    file = tmp_path_factory.mktemp("value") / "value.safetensors"
    model = pretrained(PARAMS, "value")
    assert model is not None
    write_model(file, Model("value", PARAMS, model.network))
    return file


@pytest.fixture(scope="module")
def run(value: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("imitate") / "run"
    assert main(["imitate", *SMALL.split(), "--value", str(value), "--out", str(out)]) == 0
    return out


def test_imitate__beats_random_choices(run: Path) -> None:
    assert len(log(run)) == 2
    assert all(float(row["raw_rollouts"]) == 0.0 for row in log(run))
    assert float(log(run)[-1]["critic_success"]) > 0.8  # random ones that are stable: 34 %
    assert load_policy(run / "best.safetensors").rollouts == 0
    critic, given = read_model(run / "best.safetensors").critic, pretrained(PARAMS, "value")
    assert critic is not None
    assert given is not None
    np.testing.assert_array_equal(critic.network.weights[0], given.network.weights[0])


def test_value__is_needed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert "--value" in TRAIN.refusal(capfd, "imitate", "--out", tmp_path / "run")


def test_value__of_another_kind_is_refused(
    run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ("imitate", "--value", run / "last.safetensors", "--out", tmp_path / "run")
    assert TRAIN.refusal(capfd, *words) == "model.kind = 'policy': expected value"
    assert not (tmp_path / "run").exists()


def test_imitate__that_was_killed_ends_as_if_nothing_had_happened(
    run: Path, value: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import train.imitate

    real, rounds = train.imitate._play, []

    def dying(options: object, visits: object, number: int, *rest: object) -> None:
        rounds.append(number)
        if len(rounds) == 2:
            raise KeyboardInterrupt
        real(options, visits, number, *rest)

    out = tmp_path / "run"
    words = ["imitate", *SMALL.split(), "--value", str(value), "--out", str(out)]
    monkeypatch.setattr(train.imitate, "_play", dying)
    assert main(words) == 130
    assert len(log(out)) == 1
    assert main([*words, "--resume"]) == 0
    assert rounds == [0, 1, 1]
    assert log(out) == log(run)
    one, other = (read_model(r / "best.safetensors").network for r in (out, run))
    assert same_network(one, other)


def test_export__writes_model_manifest_and_card(run: Path, tmp_path: Path) -> None:
    assert main(["export", str(run), "--into", str(tmp_path)]) == 0
    model = read_model(tmp_path / "imitate.safetensors")
    wanted = read_model(run / "best.safetensors")
    np.testing.assert_array_equal(model.network.weights[0], wanted.network.weights[0])
    assert model.critic is not None
    card = (tmp_path / "imitate.md").read_text()
    assert "python -m train imitate --rounds 2" in card
    assert "| seed | 5 |" in card
    validation = wanted.made["validation"]
    assert f"raw {validation['raw_success']:.1%} in {validation['raw_time_s']:.1f} s" in card
    assert str(tmp_path) not in json.dumps(
        dict(model.made)
    )  # the results' folder is nobody's business
    assert model.made["versions"]["torch"]


def test_export__refuses_what_is_no_finished_run(
    run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    export = ("export", tmp_path, "--into", tmp_path / "into")
    assert "the folder of a run" in TRAIN.refusal(capfd, *export)
    (tmp_path / "run.json").write_text((run / "run.json").read_text())
    told = "a finished run: train writes best.safetensors at every validation that is better"
    assert told in TRAIN.refusal(capfd, *export)
    assert not (tmp_path / "into").exists()
