"""Policies of other people in an evaluation: loaded by name, limited in time, never able to end it."""

import signal
import time
from pathlib import Path

import pytest

from evaluate.__main__ import main
from evaluate.deadline import DecisionTimeoutError, with_timeout
from evaluate.outside import is_outside, make_policy
from evaluate.protocol import Shard, run_episode, run_shard
from harness.engine import Engine
from snake_env.errors import InvalidInputError
from snake_env.policies.baselines import FirstFeasiblePolicy
from snake_env.sim.tasks import random_suite
from tests.support.commands import Command
from tests.support.policies_of_others import Sleepy, Wrong
from tests.support.robots import PAPER

EVALUATE = Command(main)

OTHERS = "tests.support.policies_of_others"
SHORT = PAPER.replace(horizon=2)


def _shard(policy: str, tasks: list[int], limit: float | None = None) -> Shard:
    return Shard.of(policy, random_suite(6, 3, SHORT), tasks, SHORT, decision_timeout_s=limit)


@pytest.mark.parametrize(
    ("name", "outside"),
    [
        ("module:factory", True),
        ("package.module:Class", True),
        ("module:factory+shield", True),
        ("lookahead:width", False),
        ("lookahead:width=4", False),
        ("analytic", False),
        ("runs/ppo-s0/best.safetensors", False),
        ("C:model.safetensors", False),
    ],
)
def test_outside__is_module_and_factory(name: str, outside: bool) -> None:
    assert is_outside(name) is outside


def test_policy_of_a_module__is_made_with_the_constants() -> None:
    policy = make_policy("snake_env.policies.baselines:FirstFeasiblePolicy", SHORT)
    assert isinstance(policy, FirstFeasiblePolicy)
    assert policy.params == SHORT


def test_policy_of_a_module__does_what_it_does_by_name() -> None:
    own = run_shard(_shard("snake_env.policies.baselines:FirstFeasiblePolicy", [0, 1]))
    known = run_shard(_shard("first-feasible", [0, 1]))
    assert [row | {"policy": ""} for row in own] == [row | {"policy": ""} for row in known]


def test_policy_of_a_module__can_be_shielded() -> None:
    shielded = make_policy("snake_env.policies.baselines:RandomPolicy+shield", PAPER)
    by_name = make_policy("random+shield", PAPER)
    state = random_suite(1, 0, PAPER).initial(0, PAPER)
    for policy in (shielded, by_name):
        policy.reset(5)
    assert shielded.select_mode(state) == by_name.select_mode(state)
    assert shielded.rollouts == by_name.rollouts >= 1


BAD = {
    "no_such_module:make": r"can be imported \(ModuleNotFoundError: No module named 'no_such_mod",
    "broken_module:make": r"can be imported \(SyntaxError: ",
    "leaving_module:make": r"can be imported \(SystemExit: 3\)",
    f"{OTHERS}:missing": f"something in {OTHERS} that can be called",
    f"{OTHERS}:NOT_CALLABLE": f"something in {OTHERS} that can be called",
    f"{OTHERS}:failing": r"a factory that makes a policy .*\(RuntimeError: no weights\)",
    f"{OTHERS}:time": "something in .* that can be called",
    f"{OTHERS}:no_policy": "a policy; a object has no method reset",
    f"{OTHERS}:uncounted": "a policy; a FirstFeasiblePolicy has no integer rollouts",
}


@pytest.mark.parametrize("name", BAD)
def test_bad_policy__is_refused_with_the_reason(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken_module.py").write_text("def make(:\n")
    (tmp_path / "leaving_module.py").write_text("raise SystemExit(3)\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InvalidInputError, match=BAD[name]):
        make_policy(name, PAPER)
    told = EVALUATE.refusal(capsys, "--policy", name)
    assert told.startswith(f"policy = '{name}': expected ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("tests.x:make", "POLICY = 'tests.x:make': expected --policy before MODULE:FACTORY"),
        ("--policy analytic", "policy = 'analytic': expected MODULE:FACTORY"),
        ("--policy lookahead:width", "policy = 'lookahead:width': expected MODULE:FACTORY"),
        ("random --decision-timeout 0", "decision_timeout = 0.0: expected seconds, more than 0"),
        ("random --decision-timeout nan", "decision_timeout = nan: expected seconds, more than 0"),
        ("random --decision-timeout inf", "decision_timeout = inf: expected seconds, more than 0"),
    ],
)
def test_bad_options__are_refused(
    arguments: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in EVALUATE.refusal(capsys, *arguments.split())


def test_policy_that_takes_forever__ends_its_episode_only() -> None:
    shard = _shard(f"{OTHERS}:Sleepy", [0, 1, 2, 3, 4], limit=0.3)
    for rows in Engine(workers=2).map(run_shard, [shard, _shard(f"{OTHERS}:Sleepy", [5], 5.0)]):
        for row in rows:
            slept = row["task"] in (1, 3)
            assert (row["outcome"] == "error") == slept
            expected = "DecisionTimeoutError: no decision within 0.3 s" if slept else ""
            assert row["error"] == expected
            assert row["intervals"] == (0 if slept else 2)


def test_limit__leaves_no_alarm_behind() -> None:
    before = signal.getsignal(signal.SIGALRM)
    assert with_timeout(30.0, lambda x: x + 1, 1) == 2
    with pytest.raises(ZeroDivisionError):
        with_timeout(30.0, lambda: 1 // 0)
    with pytest.raises(DecisionTimeoutError):
        with_timeout(0.01, time.sleep, 60)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert signal.getsignal(signal.SIGALRM) is before


def test_limit__goes_through_code_that_swallows_exceptions() -> None:
    policy = Sleepy(PAPER)
    policy.reset(1)
    state = random_suite(1, 0, PAPER).initial(0, PAPER)
    with pytest.raises(DecisionTimeoutError):
        with_timeout(0.05, policy.select_mode, state)


@pytest.mark.parametrize(
    ("policy", "error"),
    [
        ("Wrong", "InvalidModeError: mode = 4711: expected an integer from 0 to 98"),
        ("Leaving", "SystemExit: bye"),
    ],
)
def test_policy_that_goes_wrong__is_named_and_the_run_goes_on(policy: str, error: str) -> None:
    rows = run_shard(_shard(f"{OTHERS}:{policy}", [0, 1]))
    assert [row["outcome"] for row in rows] == ["error", "error"]
    assert {row["error"] for row in rows} == {error}


def test_mode_of_another_phase__is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mode 1 lifts wheel 2, which phase 3 needs on the ground."""
    monkeypatch.setattr(Wrong, "select_mode", lambda policy, state: 1)
    state = random_suite(1, 0, PAPER).initial(0, PAPER).replace(phase=3)
    row = run_episode(Wrong(PAPER), state, PAPER, 0)
    assert row["outcome"] == "error"
    assert row["error"].startswith("InvalidModeError: mode = 1: expected ")
