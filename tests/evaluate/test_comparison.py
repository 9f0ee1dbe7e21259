"""Comparisons of policies against closed forms, other people's code and data made to be known."""

import itertools
import json
import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluate.comparison import (
    Results,
    bootstrap_interval,
    compare,
    compare_all,
    holm,
    mcnemar,
    mean_interval,
    profile,
    signed_rank,
)
from evaluate.seeds import groups, mean_over_seeds, seed_entries
from evaluate.summary import build_summary, sentences
from tests.support.evaluations import rows_of
from tests.support.robots import PAPER

HORIZON = 300.0
INTERVALS = (
    *("time_difference_s", "time_ratio", "cost_difference"),
    *("restricted_time_difference_s", "probability_of_improvement"),
)
pytestmark = pytest.mark.filterwarnings("error")


def _results(times: Sequence[float | None], cost: float = 5.0) -> Results:
    """One policy's results; None is a failure."""
    rows: list[dict[str, Any]] = [
        {
            "outcome": "deadlock" if time is None else "success",
            "time_s": 12.0 if time is None else time,
            "cost_integral": cost,
        }
        for time in times
    ]
    return Results.of(rows, HORIZON)


def _compare(first: Sequence[float | None], second: Sequence[float | None]) -> dict[str, Any]:
    (entry,) = compare_all({"analytic": _results(first), "ppo": _results(second)})
    json.dumps(entry, allow_nan=False)
    return entry


def test_results__count_a_failure_as_the_horizon() -> None:
    results = _results([30.0, None, 330.0])
    assert results.solved.tolist() == [True, False, True]
    assert results.time_s.tolist() == [30.0, 300.0, 300.0]


@given(st.integers(0, 60), st.integers(0, 60))
def test_mcnemar__is_the_sum_of_binomial_probabilities(b: int, c: int) -> None:
    n = b + c
    tail = sum(math.comb(n, k) for k in range(min(b, c) + 1)) / 2**n
    assert mcnemar(b, c) == pytest.approx(min(1.0, 2 * tail))


def test_mcnemar__of_the_paper_against_a_perfect_policy() -> None:
    assert mcnemar(0, 4) == 0.125


@pytest.mark.parametrize("count", [1, 2, 6, 10])
def test_signed_rank__is_what_all_signs_give(count: int) -> None:
    """The p-value by going through all 2^n assignments of signs; differences of distinct sizes."""
    rng = np.random.default_rng(count)
    values = rng.permutation(np.arange(1, count + 1)) * rng.choice([-1.0, 1.0], count)
    ranks = np.abs(values)
    positive = ranks[values > 0].sum()
    sums = [np.dot(s, ranks) for s in itertools.product([0, 1], repeat=count)]
    middle = ranks.sum() / 2
    extreme = np.mean([abs(total - middle) >= abs(positive - middle) for total in sums])
    assert signed_rank(values) == pytest.approx(extreme)


@pytest.mark.parametrize("same", [0, 1, 95])
def test_signed_rank__is_exact_for_few_differences_beside_tasks_without(same: int) -> None:
    values = np.append(np.full(5, 3.0), np.zeros(same))
    assert signed_rank(values) == pytest.approx(2 / 2**5)


def test_signed_rank__with_many_ties_is_the_normal_approximation() -> None:
    """Times are multiples of 3 s: most differences are 0 or occur often."""
    values = np.repeat([-6.0, -3.0, 0.0, 3.0], [20, 60, 90, 30])
    given = values[values != 0]
    ranks = scipy.stats.rankdata(np.abs(given))
    n, ties = len(given), np.unique(ranks, return_counts=True)[1]
    variance = n * (n + 1) * (2 * n + 1) / 24 - (ties**3 - ties).sum() / 48
    z = (ranks[given > 0].sum() - n * (n + 1) / 4) / math.sqrt(variance)
    assert signed_rank(values) == pytest.approx(2 * scipy.stats.norm.sf(abs(z)))


def test_holm__of_known_values() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, 0.9]) == [1.0, 1.0]
    assert holm([0.03]) == [0.03]
    assert holm([]) == []


def test_mean_interval__agrees_with_students() -> None:
    values = np.random.default_rng(3).normal(2.0, 5.0, 2000)
    interval = mean_interval(values)
    assert interval is not None
    student = scipy.stats.t.interval(0.95, 1999, values.mean(), scipy.stats.sem(values))
    assert interval["mean"] == pytest.approx(values.mean())
    assert (interval["low"], interval["high"]) == pytest.approx(student, abs=0.03)


def test_mean_interval__covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    covered = 0
    for _ in range(200):
        interval = mean_interval(rng.exponential(1.0, 200))
        assert interval is not None
        covered += interval["low"] <= 1.0 <= interval["high"]
    assert 180 <= covered <= 198  # 190 are expected


def test_ratio__is_resampled_in_pairs() -> None:
    """The policy needs 0.9 of the reference's time on every task: so does every resample."""
    times = np.random.default_rng(0).uniform(24, 100, 50)
    entry = _compare(times.tolist(), (0.9 * times).tolist())
    assert entry["time_ratio"] == pytest.approx({"mean": 0.9, "low": 0.9, "high": 0.9})
    unpaired = bootstrap_interval(lambda a, axis: a.mean(axis=axis), times)
    assert unpaired is not None
    assert unpaired["high"] - unpaired["low"] > 5.0


def test_interval__does_not_depend_on_how_many_are_resampled_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    values = np.random.default_rng(1).normal(size=300)
    whole = mean_interval(values)
    monkeypatch.setattr("evaluate.comparison._BATCH", 900)
    assert mean_interval(values) == whole


def test_comparison__counts_who_solved_what() -> None:
    first = [30.0] * 40 + [None] * 12 + [33.0] * 2
    second = [27.0] * 40 + [60.0] * 12 + [None] * 2
    entry = _compare(first, second)
    assert (entry["n"], entry["common"]) == (54, 40)
    assert (entry["only_reference"], entry["only_policy"]) == (2, 12)
    assert entry["success_difference"] == pytest.approx(10 / 54)
    p = scipy.stats.binomtest(2, 14).pvalue
    assert entry["mcnemar_p"] == entry["mcnemar_p_holm"] == p
    assert entry["time_difference_s"] == {"mean": -3.0, "low": -3.0, "high": -3.0}
    assert entry["cost_difference"] == {"mean": 0.0, "low": 0.0, "high": 0.0}
    restricted = (40 * -3.0 + 12 * -240.0 + 2 * 267.0) / 54
    assert entry["restricted_time_difference_s"]["mean"] == pytest.approx(restricted)
    assert entry["probability_of_improvement"]["mean"] == pytest.approx(52 / 54)
    assert entry["sentence"] == (
        "ppo solves 52 of 54 tasks, analytic 42 (p = 0.013); "
        "3.0 s faster on the 40 tasks that both solve (95 % CI 3.0 to 3.0 s)"
    )


def test_comparison__is_the_mirror_image_from_the_other_side() -> None:
    rng = np.random.default_rng(2)
    first, second = (
        [None if rng.random() < 0.1 else float(t) for t in rng.integers(8, 30, 200) * 3]
        for _ in range(2)
    )
    here, there = _compare(first, second), _compare(second, first)
    assert here["only_policy"] == there["only_reference"]
    for key in ("mcnemar_p", "wilcoxon_p"):
        assert here[key] == pytest.approx(there[key])
    for key in ("time_difference_s", "restricted_time_difference_s"):
        assert here[key]["low"] == pytest.approx(-there[key]["high"])
    share = here["probability_of_improvement"]["mean"]
    assert share + there["probability_of_improvement"]["mean"] == pytest.approx(1.0)


def test_identical_policies__do_not_differ() -> None:
    times = [30.0, 36.0, None, 42.0]
    entry = _compare(times, times)
    assert entry["mcnemar_p"] == 1.0
    assert entry["wilcoxon_p"] is None
    assert entry["time_difference_s"] == {"mean": 0.0, "low": 0.0, "high": 0.0}
    assert entry["time_ratio"] == {"mean": 1.0, "low": 1.0, "high": 1.0}
    assert entry["probability_of_improvement"] == {"mean": 0.5, "low": 0.5, "high": 0.5}
    assert entry["sentence"] == (
        "ppo solves 3 of 4 tasks, the same as analytic; as fast on the 3 tasks that both solve"
    )


def test_one_task__has_no_intervals() -> None:
    entry = _compare([30.0], [27.0])
    assert all(entry[key] is None for key in INTERVALS)
    assert (entry["mcnemar_p"], entry["wilcoxon_p"]) == (1.0, 1.0)
    assert entry["sentence"].endswith("; no significant difference in time on the one both solve")


def test_no_common_task__has_no_times() -> None:
    entry = _compare([30.0, 30.0, None, None], [None, None, 30.0, 30.0])
    assert entry["common"] == 0
    for key in ("time_difference_s", "time_ratio", "cost_difference", "wilcoxon_p"):
        assert entry[key] is None
    assert entry["restricted_time_difference_s"]["mean"] == 0.0
    assert entry["sentence"] == (
        "ppo solves 2 of 4 tasks, analytic 2 (no significant difference, p = 1); "
        "no task is solved by both"
    )


def test_all_failures__are_all_ties() -> None:
    entry = _compare([None] * 5, [None] * 5)
    assert entry["probability_of_improvement"] == {"mean": 0.5, "low": 0.5, "high": 0.5}
    assert entry["restricted_time_difference_s"] == {"mean": 0.0, "low": 0.0, "high": 0.0}


def test_policy_without_cost__has_no_difference_of_cost() -> None:
    first, second = _results([30.0, 33.0, 36.0]), _results([3.0, 3.3, 3.9], cost=math.nan)
    entry = compare("analytic", first, "skid", second)
    assert entry["cost_difference"] is None
    assert entry["time_difference_s"] is not None


def test_noise__establishes_nothing() -> None:
    rng = np.random.default_rng(4)
    first, second = (rng.integers(8, 30, 300) * 3.0 for _ in range(2))
    entry = _compare(first.tolist(), second.tolist())
    assert entry["time_difference_s"]["low"] < 0 < entry["time_difference_s"]["high"]
    assert "no significant difference in time" in entry["sentence"]


@pytest.mark.parametrize("tasks", [3, 6, 19, 20])
def test_few_equal_differences__are_not_significant(tasks: int) -> None:
    """Their bootstrap interval is a point."""
    told = _compare([30.0] * tasks, [27.0] * tasks)["sentence"]
    assert ("no significant difference in time" in told) == (tasks < 20)


@pytest.mark.parametrize("tasks", [2, 5, 20])
def test_seeds_on_few_tasks__are_not_significantly_better(tasks: int) -> None:
    names = [f"runs/ppo-s{k}/best.safetensors" for k in range(2)]
    own = {name: _results([30.0] * tasks) for name in names}
    (entry,) = seed_entries({"analytic": _results([None] * tasks), **own}).values()
    assert "+100.00 points against analytic" in entry["sentence"]
    assert ("no significant difference" in entry["sentence"]) == (tasks < 20)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("shift", [-0.2, 0.0, 0.1, 0.6])
def test_time_sentence__says_what_its_interval_says(seed: int, shift: float) -> None:
    """Differences that the signed-rank test and the interval of the mean judge differently."""
    rng = np.random.default_rng(seed)
    first = rng.integers(8, 30, 60) * 3.0
    second = np.maximum(first + shift + rng.exponential(3.0, 60) - 3.0, 1.0)
    entry = _compare(first.tolist(), second.tolist())
    interval, told = entry["time_difference_s"], entry["sentence"].split("; ")[1]
    significant = interval["low"] > 0 or interval["high"] < 0
    assert ("no significant difference in time" not in told) == significant
    low, high = map(float, re.search(r"CI (\S+) to (\S+) s\)", told).groups())
    assert (low > 0 or high < 0) == significant  # so it looks


def test_skewed_times__are_judged_by_the_interval_that_is_shown() -> None:
    """Most tasks take a little longer, a few take much less: the signed-rank test sees most."""
    first = [60.0] * 40
    second = [60.3] * 34 + [30.0] * 6
    entry = _compare(first, second)
    assert entry["wilcoxon_p"] < 0.05
    assert entry["time_difference_s"]["high"] < 0
    assert "4.2 s faster" in entry["sentence"]


def test_tiny_difference__does_not_look_like_none() -> None:
    entry = _compare([30.0] * 40, [30.002] * 40)
    assert "; 0.002 s slower on the 40 tasks that" in entry["sentence"]
    assert entry["sentence"].endswith("(95 % CI 0.002 to 0.002 s)")


def test_p_values__are_corrected_when_there_are_several() -> None:
    reference = [30.0] * 40 + [None] * 7
    results = {
        "analytic": _results(reference),
        "a": _results([30.0] * 46 + [None]),
        "b": _results([27.0] * 40 + [30.0] * 7),
    }
    a, b = compare_all(results)
    assert (a["mcnemar_p"], b["mcnemar_p"]) == (2 / 2**6, 2 / 2**7)
    assert (a["mcnemar_p_holm"], b["mcnemar_p_holm"]) == (2 / 2**6, 4 / 2**7)
    assert a["wilcoxon_p_holm"] is None
    assert b["wilcoxon_p_holm"] == b["wilcoxon_p"]  # the only one
    assert "p = 0.031 after Holm)" in a["sentence"]


@pytest.mark.parametrize("names", [("analytic", "skid", "ppo"), ("skid", "analytic", "ppo")])
@pytest.mark.parametrize("suffix", ["", " (runs/a)"])
def test_skid__is_compared_with_nobody(names: tuple[str, ...], suffix: str) -> None:
    config = {"tasks": {}, "preset": "paper", "params": {}, "models": {}, "slip": [0.0, 0.0]}
    rows = {name: [row | {"policy": name} for row in rows_of("random")] for name in names}
    rows = {f"{name}{suffix}" if name == "skid" else name: rows[name] for name in names}
    summary = build_summary(config, rows, {}, PAPER, "")
    assert list(summary["policies"]) == list(rows)
    pairs = [(entry["reference"], entry["policy"]) for entry in summary["comparisons"]]
    assert pairs == [("analytic", "ppo")]
    assert list(summary["profiles"]) == ["analytic", "ppo"]
    assert not any("skid" in sentence for sentence in sentences(summary))


def test_skid_alone__has_no_comparisons() -> None:
    config = {"tasks": {}, "preset": "paper", "params": {}, "models": {}, "slip": [0.0, 0.0]}
    summary = build_summary(config, {"skid": rows_of("skid")}, {}, PAPER, "")
    assert (summary["comparisons"], summary["profiles"], summary["seeds"]) == ([], {}, {})


def test_one_policy__is_compared_with_nothing() -> None:
    assert compare_all({"analytic": _results([30.0])}) == []


def test_profile__is_the_share_solved_in_time() -> None:
    assert profile(_results([30.0, 27.0, None, 30.0])) == {
        "time_s": [27.0, 30.0],
        "share": [0.25, 0.75],
    }
    assert profile(_results([None])) == {"time_s": [], "share": []}


def test_groups__are_runs_that_differ_in_their_seed() -> None:
    seeds = [f"runs/ppo-paper-s{k}/best.safetensors" for k in (0, 1, 12)]
    others = ["analytic", "runs/dqn-paper-s0/best.safetensors", f"{seeds[0]}+shield", "my-s1"]
    assert groups(["analytic", *seeds, *others]) == {"runs/ppo-paper-s*/best.safetensors": seeds}


def test_groups__one_policy_in_several_result_folders_is_no_group() -> None:
    assert groups(["analytic (out-s1/a)", "analytic (out-s2/a)"]) == {}
    twice = [f"runs/m-s{seed}/best (out-s1/a)" for seed in (0, 1)]
    assert groups(twice) == {"runs/m-s*/best (out-s1/a)": twice}


@settings(deadline=None, max_examples=5)
@given(st.integers(2, 5))
def test_mean_over_seeds__of_equal_seeds_is_that_of_tasks(seeds: int) -> None:
    values = np.random.default_rng(0).normal(size=400)
    one, many = mean_interval(values), mean_over_seeds(np.tile(values, (seeds, 1)))
    assert one is not None
    assert many is not None
    assert many["mean"] == pytest.approx(one["mean"])
    assert many["low"] == pytest.approx(one["low"], abs=0.02)
    assert many["high"] == pytest.approx(one["high"], abs=0.02)


def test_mean_over_seeds__of_seeds_that_differ_is_wide() -> None:
    """Every task gives the seed's own value: the interval is that of the seeds' mean."""
    levels = np.arange(5.0)
    interval = mean_over_seeds(np.tile(levels[:, None], (1, 1000)))
    draws = np.array(list(itertools.product(levels, repeat=5))).mean(axis=1)
    assert interval is not None
    assert (interval["low"], interval["high"]) == pytest.approx(
        np.percentile(draws, [2.5, 97.5]), abs=0.21
    )
    assert mean_over_seeds(levels[None]) is None
    assert mean_over_seeds(levels[:, None]) is None


def test_seeds__have_a_best_a_median_and_a_worst() -> None:
    names = [f"runs/ppo-s{k}/best.safetensors" for k in range(3)]
    results = {
        "analytic": _results([30.0, 30.0, 30.0, None]),
        names[0]: _results([30.0, None, 30.0, None]),
        names[1]: _results([30.0, 30.0, 30.0, 60.0]),
        names[2]: _results([27.0, None, 30.0, None]),
    }
    (entry,) = seed_entries(results).values()
    assert [entry[mark]["policy"] for mark in ("best", "median", "worst")] == [
        *(names[1], names[2], names[0])
    ]
    assert entry["best"]["restricted_mean_time_s"] == 37.5
    assert entry["success_rate"]["mean"] == pytest.approx(8 / 12)
    assert entry["reference"] == "analytic"
    assert entry["success_difference"]["mean"] == pytest.approx(8 / 12 - 0.75)
    assert "3 seeds of runs/ppo-s*/best.safetensors solve 100.00 % (best)" in entry["sentence"]
    assert "no significant difference" in entry["sentence"]
    json.dumps(entry, allow_nan=False)


def test_seeds__without_reference_stand_alone() -> None:
    names = [f"runs/ppo-s{k}/best.safetensors" for k in range(2)]
    (entry,) = seed_entries({name: _results([30.0, 33.0]) for name in names}).values()
    assert "reference" not in entry
    assert entry["sentence"].endswith("100.00 % (worst)")
