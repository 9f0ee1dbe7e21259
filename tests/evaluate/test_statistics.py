"""The figures of a policy against closed formulas and hand-made rows."""

import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluate.statistics import decisions_of, summarise, wilson95
from tests.support.robots import PAPER

Z = 1.959963984540054  # 97.5 % quantile of the normal distribution


def _row(outcome: str = "success", time_s: float = 30.0, **changes: Any) -> dict[str, Any]:
    row = {
        "policy": "p", "task": 0, "outcome": outcome, "intervals": 10, "time_s": time_s,
        "phase": 9 if outcome == "success" else 7, "cost_integral": 5.0, "d_min": 0.25,
        "max_abs_phi": 1.5, "head_error_m": 0.0, "head_error_rad": 0.0, "shape_error_rad": 0.03,
        "rollouts": 100, "modes": " ".join(["3"] * 10), "error": "",
    }  # fmt: skip
    return {**row, **changes}


@given(st.integers(1, 2000), st.data())
def test_wilson__is_the_closed_formula(n: int, data: st.DataObject) -> None:
    k = data.draw(st.integers(0, n))
    p = k / n
    centre = (p + Z**2 / (2 * n)) / (1 + Z**2 / n)
    half = Z / (1 + Z**2 / n) * math.sqrt(p * (1 - p) / n + Z**2 / (4 * n**2))
    low, high = wilson95(k, n)
    assert low == pytest.approx(max(centre - half, 0.0), abs=1e-12)
    assert high == pytest.approx(min(centre + half, 1.0), abs=1e-12)
    assert 0.0 <= low <= p <= high <= 1.0


@pytest.mark.parametrize(
    ("k", "n", "low", "high"),
    [
        (496, 500, 0.97961, 0.99688),  # the paper's
        (0, 10, 0.0, 0.27753),
        (10, 10, 0.72247, 1.0),
        (1, 2, 0.09453, 0.90547),
    ],
)
def test_wilson__has_known_values(k: int, n: int, low: float, high: float) -> None:
    assert wilson95(k, n) == pytest.approx((low, high), abs=6e-6)


def test_summary__of_mixed_rows() -> None:
    rows = [
        _row(time_s=27.0, cost_integral=4.0, d_min=0.3, shape_error_rad=0.01),
        _row(time_s=36.0, cost_integral=5.0, d_min=0.2, shape_error_rad=0.05),
        _row(time_s=36.0, cost_integral=9.0, max_abs_phi=1.57),
        _row("deadlock", 300.0, cost_integral=270.0, head_error_m=0.5, head_error_rad=0.2),
        _row("stability", 7.5, phase=2, d_min=0.15),
        _row("stability", 9.5, phase=2),
        _row("joint_limit", 1.0, phase=1, max_abs_phi=1.58),
        _row("error", 0.0, phase=1, d_min=math.inf, cost_integral=0.0, rollouts=0),
    ]
    latencies = [float(k) for k in range(1, 101)]
    summary = summarise(rows, latencies, PAPER)
    assert (summary["n"], summary["success"], summary["success_rate"]) == (8, 3, 0.375)
    assert summary["wilson95"] == list(wilson95(3, 8))
    assert summary["time_s"] == {"min": 27.0, "median": 36.0, "mean": 33.0, "max": 36.0}
    assert summary["restricted_mean_time_s"] == (27 + 36 + 36 + 5 * 300) / 8
    assert summary["cost_integral"] == 6.0
    assert (summary["d_min"], summary["max_abs_phi"]) == (0.15, 1.58)
    assert summary["head_error_m"] == pytest.approx(0.5 / 8)
    assert summary["head_error_rad"] == pytest.approx(0.2 / 8)
    errors = {"median": 0.03, "p90": pytest.approx(0.03 + 0.8 * 0.02), "max": 0.05}
    assert summary["shape_error_rad"] == errors  # of the successes only
    assert summary["name"] == "p"
    assert summary["violations"] == 3
    counts = {"deadlock": 1, "error": 1, "joint_limit": 1, "stability": 2, "success": 3}
    assert summary["outcomes"] == counts
    assert summary["failures_by_phase"] == {
        "deadlock in phase 7": 1,
        "error in phase 1": 1,
        "joint_limit in phase 1": 1,
        "stability in phase 2": 2,
    }
    assert summary["rollouts_per_decision"] == 700 / 81  # the deadlock: one more
    assert summary["decision_latency_us"] == pytest.approx(
        {"p50": 50.5, "p95": 95.05, "p99": 99.01}
    )
    json.dumps(summary, allow_nan=False)


def test_summary__without_success_has_no_times() -> None:
    summary = summarise([_row("horizon", 300.0), _row("collision", 9.0)], [1.0], PAPER)
    assert summary["time_s"] == dict.fromkeys(("min", "median", "mean", "max"))
    assert summary["cost_integral"] is None
    assert summary["shape_error_rad"] == dict.fromkeys(("median", "p90", "max"))
    assert summary["restricted_mean_time_s"] == 300.0
    assert (summary["success_rate"], summary["violations"]) == (0.0, 1)
    assert summary["wilson95"][0] == 0.0
    json.dumps(summary, allow_nan=False)


def test_summary__of_successes_only_has_no_failures() -> None:
    summary = summarise([_row(), _row(time_s=60.0)], [2.0, 4.0], PAPER)
    assert (summary["success_rate"], summary["wilson95"][1]) == (1.0, 1.0)
    assert summary["time_s"]["median"] == summary["time_s"]["mean"] == 45.0
    assert summary["restricted_mean_time_s"] == 45.0
    assert summary["failures_by_phase"] == {}
    assert summary["violations"] == 0


def test_summary__of_one_row_without_decisions_or_cost() -> None:
    """As of ``skid``, which has neither."""
    row = _row(time_s=2.5, cost_integral=math.nan, rollouts=0, modes="")
    summary = summarise([row], [], PAPER)
    assert summary["time_s"] == dict.fromkeys(("min", "median", "mean", "max"), 2.5)
    assert summary["cost_integral"] is None
    assert summary["rollouts_per_decision"] is None
    assert summary["decision_latency_us"] == dict.fromkeys(("p50", "p95", "p99"))
    json.dumps(summary, allow_nan=False)


@pytest.mark.parametrize(
    ("outcome", "modes", "decisions"),
    [
        ("success", 10, 10),
        ("horizon", 100, 100),
        ("stability", 1, 1),
        ("deadlock", 100, 100),  # it stood still at the horizon: every decision was executed
        ("deadlock", 12, 13),  # the last found no feasible mode
        ("deadlock", 0, 1),
        ("error", 0, 0),
    ],
)
def test_decisions__are_those_of_the_row(outcome: str, modes: int, decisions: int) -> None:
    row = _row(outcome, intervals=modes, modes=" ".join(["98"] * modes))
    assert decisions_of(row, PAPER) == decisions


def test_restricted_mean__stops_at_the_horizon_of_the_constants() -> None:
    params = PAPER.replace(horizon=5)
    rows = [_row(time_s=12.0), _row("deadlock", 6.0), _row(time_s=21.0)]
    summary = summarise(rows, [1.0], params)
    assert summary["restricted_mean_time_s"] == (12 + 15 + 15) / 3
    assert summary["time_s"]["max"] == 21.0
