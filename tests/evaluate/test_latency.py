"""How decisions are timed: in the states of the policy's own episodes, in turns."""

from typing import Any

import numpy as np
import pytest

from evaluate import latency
from evaluate.latency import measure_latencies
from evaluate.protocol import Row
from snake_env.policies.baselines import FirstFeasiblePolicy
from snake_env.policies.registry import POLICIES
from snake_env.sim.tasks import random_suite
from snake_env.state import SnakeState
from tests.support.evaluations import evaluated
from tests.support.robots import PAPER

SHORT = PAPER.replace(horizon=4)
SUITE = random_suite(5, 3, SHORT)
CALLS: list[tuple[str, int | None, float, bytes]] = []


class _Noting(FirstFeasiblePolicy):
    """Notes where it is asked to decide, and fails once told to."""

    name = "noting"
    fail_at: int | None = None

    def reset(self, seed: int | None = None) -> None:
        self.seed = seed

    def select_mode(self, state: SnakeState) -> int:
        CALLS.append((self.name, self.seed, state.elapsed, state.phi.tobytes()))
        if len(CALLS) == self.fail_at:
            raise ValueError("not again")
        return super().select_mode(state)


class _Other(_Noting):
    name = "other"


@pytest.fixture(autouse=True)
def _policies(monkeypatch: pytest.MonkeyPatch) -> None:
    CALLS.clear()
    monkeypatch.setitem(POLICIES, "noting", _Noting)
    monkeypatch.setitem(POLICIES, "other", _Other)


def _rows(policy: str) -> list[Row]:
    return evaluated(policy, SUITE, SHORT)


def test_decisions__are_made_again_in_the_episodes_states() -> None:
    rows = {"noting": _rows("noting")}
    during = list(CALLS)
    CALLS.clear()
    durations = measure_latencies(rows, SUITE, SHORT)
    assert during == CALLS
    assert len(durations["noting"]) == len(during) - 1  # the first warms up
    assert all(duration > 0 for duration in durations["noting"])


def test_policies__take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {name: _rows(name) for name in ("noting", "other")}
    CALLS.clear()
    monkeypatch.setattr(latency, "TURN", 8)
    durations = measure_latencies(rows, SUITE, SHORT)
    assert [name for name, *_ in CALLS] == [*["noting"] * 8, *["other"] * 8] * 2 + [
        *["noting"] * 4, *["other"] * 4,
    ]  # fmt: skip
    assert [len(own) for own in durations.values()] == [19, 19]


def test_decisions__are_bounded_in_number_and_time(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {"noting": _rows("noting")}
    monkeypatch.setattr(latency, "DECISIONS", 3)
    assert len(measure_latencies(rows, SUITE, SHORT)["noting"]) == 3
    assert [seed for _, seed, *_ in CALLS[-4:]] == [0] * 4
    monkeypatch.setattr(latency, "SECONDS", 0.0)
    assert measure_latencies(rows, SUITE, SHORT)["noting"] == []


def test_decisions__are_spread_over_the_suite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latency, "DECISIONS", 3)
    assert latency._spread(5) == [0, 2, 4]
    assert latency._spread(2) == [0, 1]
    assert latency._spread(1) == [0]


def test_episodes_that_ended_by_an_error__are_left_out() -> None:
    rows = [row | {"error": "E"} if row["task"] != 2 else row for row in _rows("noting")]
    CALLS.clear()
    measure_latencies({"noting": rows}, SUITE, SHORT)
    assert {seed for _, seed, *_ in CALLS} == {2}


def test_policy_that_fails_now__keeps_what_was_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {"noting": _rows("noting")}
    CALLS.clear()
    monkeypatch.setattr(_Noting, "fail_at", 6)
    assert len(measure_latencies(rows, SUITE, SHORT)["noting"]) == 4


def test_skid__decides_nothing() -> None:
    assert measure_latencies({"skid": _rows("skid")}, SUITE, SHORT) == {"skid": []}


def test_linear_algebra__runs_on_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    threadpoolctl: Any = pytest.importorskip("threadpoolctl")
    seen: set[int] = set()

    def select(policy: _Noting, state: SnakeState) -> int:
        assert np.linalg.inv(np.eye(3)).shape == (3, 3)
        seen.update(pool["num_threads"] for pool in threadpoolctl.threadpool_info())
        return FirstFeasiblePolicy.select_mode(policy, state)

    rows = {"noting": _rows("noting")}
    monkeypatch.setattr(_Noting, "select_mode", select)
    measure_latencies(rows, SUITE, SHORT)
    assert seen == {1}
