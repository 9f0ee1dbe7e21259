"""The report: what the page says, what it replays, and that it survives poor results."""

import base64
import hashlib
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluate.protocol import Row, check_policy
from evaluate.replay import replay
from evaluate.report import charts, replays, svg, write_report
from evaluate.report.episodes import DISAGREEMENTS, FAILURES_EACH, choose
from evaluate.report.motion import QUANTUM, decode_angles, frame_steps, motion_of
from evaluate.report.page import render
from evaluate.report.replays import collect
from evaluate.statistics import summarise, wilson95
from snake_env.params import SnakeParams
from snake_env.policies.skid import skid
from snake_env.sim.episode import STILL
from snake_env.sim.tasks import TaskSuite, load_tasks, random_suite
from tests.support import ROOT
from tests.support.evaluations import SUITE, evaluated, rows_of, summary_of
from tests.support.robots import PAPER, row_of

POLICIES = ("analytic", "random", "skid")
VOID = {"meta", "link", "br", "input"}
MEGABYTE = 1_000_000


def page_of(rows: dict[str, list[Row]], suite: TaskSuite = SUITE, **more: Any) -> str:
    """The page for some rows, without simulation 1."""
    policies = list(rows)
    episodes = collect(policies, rows, PAPER, suite)
    return render(policies, rows, summary_of(rows, **more), PAPER, episodes)


class Outline(HTMLParser):
    """A page as a reader meets it; complains about elements that are closed wrongly."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.table: list[list[str]] = []
        self.text = ""
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.table.append([])
        if tag in ("th", "td"):
            self.table[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.open):
            self.text += data
            if {"th", "td"} & set(self.open):
                self.table[-1][-1] += data.strip()

    def rows(self, first: str) -> list[list[str]]:
        """Rows of the tables that begin with a text."""
        return [row for row in self.table if row[0] == first]


def data_of(page: str) -> dict[str, Any]:
    """What the page hands to the player."""
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    data: dict[str, Any] = json.loads(text)
    return data


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A report as the command writes it."""
    folder = tmp_path_factory.mktemp("report")
    rows = {policy: rows_of(policy) for policy in POLICIES}
    path = write_report(folder, POLICIES, rows, summary_of(rows), PAPER, SUITE)
    assert [file.name for file in folder.iterdir()] == ["report.html"]
    assert path.stat().st_size < 5 * MEGABYTE
    return path.read_text(encoding="utf-8")


def test_page__is_well_formed_and_fetches_nothing(page: str) -> None:
    outline = Outline(page)
    for _, attributes in outline.tags:
        assert not attributes.keys() & {"src", "srcset", "action", "background"}
        target = attributes.get("href") or "#"
        assert target.startswith("#") or target == "data:,"
        assert not any(name.startswith("on") for name in attributes)
    assert set(re.findall(r"\w+://[^\"' )]+", page)) <= {"http://www.w3.org/2000/svg"}
    assert "@import" not in page
    assert "url(" not in page
    policy = next(a["content"] for _, a in outline.tags if a.get("http-equiv"))
    assert policy is not None
    assert policy.startswith("default-src 'none'")


def test_page__has_every_section_and_an_id_once(page: str) -> None:
    outline = Outline(page)
    ids = [attributes["id"] for _, attributes in outline.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    sections = [a["id"] for tag, a in outline.tags if tag == "section" and "id" in a]
    assert sections == ["results", "comparison", "failures", "replays", "paper", "reproduce"]
    links = [(a["href"] or "")[1:] for tag, a in outline.tags if tag == "a"]
    assert set(links) == set(sections)
    for tag, attributes in outline.tags:
        if tag == "svg" and attributes.get("aria-hidden") != "true":
            assert attributes["role"] == "img"
            assert attributes["aria-label"]


def test_results__say_what_the_summary_says(page: str) -> None:
    outline = Outline(page)
    (quoted,) = outline.rows("the paper")
    assert quoted[1:5] == ["496/500", "99.2", "98.0\u201399.7", "27"]
    (analytic,) = outline.rows("analytic")
    assert analytic[1:4] == ["6/6", "100.0", "61.0\u2013100.0"]
    assert analytic[4:9] == ["33", "39", "39.5", "51", "1.000"]
    assert analytic[9:11] == ["0.282", "1.534"]
    figures = summary_of({"analytic": rows_of("analytic")})["policies"]["analytic"]
    assert analytic[-3:] == [f"{figures['rollouts_per_decision']:.1f}", "1.05", "1.91"]  # [ms]
    (skidding,) = outline.rows("skid")
    assert skidding[1] == "6/6"
    assert skidding[8] == "\u2013"  # its times compare with nobody's
    assert float(skidding[12]) > 100.0  # [mm]: it drags the head along
    errors = [float(row[11]) for row in (analytic, skidding)]
    assert 0.0 == errors[1] < errors[0] < 0.05


def test_failures__are_counted_by_cause_and_phase(page: str) -> None:
    failed = [row for row in rows_of("random") if row["outcome"] != "success"]
    counted = [row for row in Outline(page).rows("random") if len(row) == 12]
    assert sum(int(row[10]) for row in counted) == len(failed) > 0
    for _, cause, *counts, total, tasks in counted:
        own = [row for row in failed if row["outcome"].replace("_", " ") == cause]
        assert [int(count or 0) for count in counts] == [
            sum(row["phase"] == phase for row in own) for phase in range(1, 9)
        ]
        assert int(total) == len(own)
        assert tasks == "".join(str(row["task"]) for row in own)


def test_sentences__of_the_comparisons_are_the_headlines() -> None:
    rows = {policy: rows_of(policy) for policy in ("analytic", "random")}
    comparison = {
        "reference": "analytic",
        "policy": "random",
        "sentence": "random is < analytic",
        "only_policy": 0,
        "only_reference": 4,
        "mcnemar_p_holm": 0.125,
        "common": 2,
        "time_ratio": {"mean": 2.5, "low": 2.0, "high": 3.0},
        "wilcoxon_p_holm": 0.0001,
        "time_difference_s": {"mean": 60.0, "low": 40.0, "high": 80.0},
        "restricted_time_difference_s": {"mean": 200.0, "low": -1.0, "high": 260.0},
    }
    seeds = {"x-s*": {"sentence": "Seeds differ & vary"}}
    outline = Outline(page_of(rows, comparisons=[comparison], seeds=seeds))
    assert outline.text.count("random is < analytic") == 2  # the headline, and among all
    assert "analytic, with 0 roll-outs per decision against " in outline.text
    assert "Seeds differ & vary." in outline.text
    result, pair = outline.rows("random")[:2]
    assert result[8] == "2.500"
    assert pair[1:4] == ["0", "4", "0.125"]
    assert pair[4:7] == ["2", "2.500 (2.000 to 3.000)", "60.0 (40.0 to 80.0)"]
    assert pair[7] == "<\u2009.001"
    assert pair[8:] == ["200.0 (\u22121.0 to 260.0)", "\u2013"]
    alone = Outline(page_of(rows, comparisons=[{**comparison, "time_ratio": None}]))
    assert alone.rows("random")[0][8] == "\u2013"


def test_names__are_escaped_everywhere() -> None:
    name = "</script><script>alert('&amp;')</script>\"<b>"
    rows = {name: [{**row, "policy": name} for row in rows_of("random")]}
    text = page_of(rows)
    outline = Outline(text)
    assert sum(tag == "script" for tag, _ in outline.tags) == 2
    assert not any(tag == "b" for tag, _ in outline.tags)
    assert outline.rows(name)
    assert data_of(text)["policies"] == [name]
    assert "python -m evaluate <here> & there" in outline.text


def test_replays__are_the_trajectories_within_half_a_quantum(page: str) -> None:
    data = data_of(page)
    assert data["robot"]["quantum"] == QUANTUM
    assert data["robot"]["frame_s"] == pytest.approx(0.1)
    seen = 0
    for episode in data["episodes"]:
        suite = load_tasks("sim-1", PAPER) if episode["name"] == "sim-1" else SUITE
        task = 0 if episode["name"] == "sim-1" else int(episode["name"].split()[1])
        state = suite.initial(task, PAPER)
        target = decode_angles(episode["target"], 8)
        assert abs(target[0] - state.target).max() <= QUANTUM / 2 + 1e-12
        for policy, run in zip(POLICIES, episode["runs"], strict=True):
            if policy == "skid":
                continue
            played = replay(row_of(run["modes"]), state, PAPER)
            exact = np.concatenate(
                [*(m.phi[:-1] for m in played.motions), played.states[-1].phi[None]]
            )
            shown = decode_angles(run["phi"], 8)
            assert abs(shown[:-1] - exact[:-1:5]).max() <= QUANTUM / 2 + 1e-12
            assert abs(shown[-1] - exact[-1]).max() <= QUANTUM / 2 + 1e-12
            assert run["end"] == pytest.approx(played.states[-1].elapsed)
            assert run["phases"] == [s.phase for s in played.states[: len(run["modes"])]]
            for k, bits in enumerate(run["lifted"]):
                wheels = [bool(bits >> wheel & 1) for wheel in range(8)]
                assert wheels == played.lifted(k, PAPER).tolist()
            assert "w" not in run  # the head stays
            seen += 1
    assert seen >= 8


def test_replays__show_how_skidding_drags_the_head(page: str) -> None:
    episode = data_of(page)["episodes"][1]
    run = episode["runs"][POLICIES.index("skid")]
    state = SUITE.initial(int(episode["name"].split()[1]), PAPER)
    summary, path = skid(state, PAPER)
    heads = np.frombuffer(base64.b64decode(run["w"]), dtype="<f4").reshape(-1, 3)
    np.testing.assert_allclose(heads[:-1], path[:-1:5], atol=1e-6)
    np.testing.assert_allclose(heads[-1], path[-1], atol=1e-6)
    assert abs(decode_angles(run["phi"], 8)[-1] - state.target).max() <= QUANTUM
    assert run["end"] == pytest.approx(summary.time_s)
    assert run["phases"] == run["lifted"] == run["modes"] == []


def test_replays__begin_with_what_is_typical(page: str) -> None:
    episodes = data_of(page)["episodes"]
    assert [episode["name"] for episode in episodes][:1] == ["sim-1"]
    assert [episode["group"] for episode in episodes[:3]] == ["Typical"] * 3
    names = [episode["name"] for episode in episodes]
    assert len(names) == len(set(names))
    for episode in episodes:
        assert "skid" not in (POLICIES[episode["left"]], POLICIES[episode["right"]])


def test_deadlocks__are_replayed_until_nothing_moves() -> None:
    rows = {"first-feasible": rows_of("first-feasible")}
    seen = 0
    for episode in data_of(page_of(rows))["episodes"]:
        if episode["name"] == "sim-1":
            continue
        row = rows["first-feasible"][task := int(episode["name"].split()[1])]
        (run,) = episode["runs"]
        assert (row["outcome"], run["time"]) == ("deadlock", row["time_s"])
        exact = motion_of(row, SUITE.initial(task, PAPER), PAPER).phi
        last = round(run["end"] / PAPER.dt)
        steps = round(PAPER.delta_t / PAPER.dt)
        assert last % steps == 0
        assert len(run["modes"]) == len(run["phases"]) == len(run["lifted"]) == last // steps
        ends = exact[::steps]
        turned = np.abs(np.diff(ends, axis=0)).max(axis=1)
        assert (
            turned[last // steps - 1 :] < STILL
        ).all()  # its last interval, and what is left out
        assert last == 0 or len(turned) > last // steps
        assert last == steps or turned[last // steps - 2] >= STILL
        seen += 1
    assert seen >= 4


def test_one_policy__has_one_wide_replay_and_no_chart_of_a_single_point() -> None:
    page = page_of({"analytic": rows_of("analytic")})
    assert page.count('data-side="') == page.count('data-traces="') == 1
    assert 'class="sides single"' in page
    assert "Success against" not in page
    assert "Two policies" not in page
    for name in (
        "skid",
        "skid (runs/a)",
    ):  # as evaluate compare calls it where two folders have one
        beside_skid = page_of({name: rows_of("skid"), "analytic": rows_of("analytic")})
        assert beside_skid.count('data-side="') == 1  # skid is no other policy to compare with
    both = page_of({name: rows_of(name) for name in ("analytic", "random")})
    assert both.count('data-side="') == both.count('data-traces="') == 2
    assert "Success against roll-outs" in both


def test_models__are_told_by_the_hashes_of_their_files() -> None:
    rows = {"analytic": rows_of("analytic"), "ppo+critic": rows_of("ppo+critic")}
    digests = check_policy("ppo+critic", PAPER)
    folder = ROOT / "snake_env" / "pretrained"
    files = [folder / "ppo.safetensors", folder / "value.safetensors"]
    assert digests == [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
    assert check_policy("analytic", PAPER) == check_policy("skid", PAPER) == []
    page = page_of(rows, models={"analytic": [], "ppo+critic": digests})
    assert all(page.count(digest) == 1 for digest in digests)
    assert "SHA-256" not in page_of({"analytic": rows_of("analytic")})


def test_policies__that_are_gone_leave_simulation_1_out() -> None:
    assert replays.sim_1({"no/such/model.safetensors": rows_of("analytic")}, PAPER, SUITE) == []
    assert replays.sim_1({"analytic": rows_of("analytic")}, PAPER, load_tasks("sim-1", PAPER)) == []
    (episode,) = replays.sim_1({name: rows_of(name) for name in ("skid", "analytic")}, PAPER, SUITE)
    assert (episode.choice.left, episode.choice.right) == ("analytic", "analytic")
    assert episode.rows["analytic"]["time_s"] == 36.0


def test_replays__are_left_out_beyond_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {policy: rows_of(policy) for policy in ("analytic", "random")}
    everything = data_of(page_of(rows))["episodes"]
    monkeypatch.setattr(replays, "BUDGET", len(json.dumps(everything[:2])))
    assert data_of(page_of(rows))["episodes"] == everything[:2]
    monkeypatch.setattr(replays, "BUDGET", 1)
    assert data_of(page_of(rows))["episodes"] == everything[:1]


def _row(policy: str, task: int, time_s: float, outcome: str = "success", phase: int = 9) -> Row:
    changes = {"policy": policy, "task": task, "time_s": time_s, "outcome": outcome, "phase": phase}
    return rows_of("analytic")[0] | changes


def _many() -> dict[str, list[Row]]:
    """Three policies on 40 tasks; the third fails on many, the second once."""
    return {
        "one": [_row("one", task, 30.0 + task) for task in range(40)],
        "two": [
            _row("two", task, 30.0 + 2 * task if task != 7 else 300.0,
                 "success" if task != 7 else "deadlock", 9 if task != 7 else 4)
            for task in range(40)
        ],
        "three": [
            _row("three", task, 3.0, "joint_limit" if task % 2 else "success", 1)
            for task in range(40)
        ],
    }  # fmt: skip


def test_choice__is_typical_then_failures_then_disagreements() -> None:
    chosen = choose(["one", "two", "three"], _many(), PAPER)
    median, slowest, *others = chosen
    assert (median.task, median.left, median.right) == (19, "one", "two")
    assert slowest.task == 39
    failures = [choice for choice in others if choice.group == "Failures"]
    assert [choice.task for choice in failures] == [7, 1, 3, 5]  # of three: 1, 3, 5; 7 is two's
    assert len(failures) <= 1 + FAILURES_EACH
    assert failures[0].why == "two: deadlock in phase 4"
    assert {failures[0].left, failures[0].right} == {"two", "three"} or failures[0].left == "one"
    apart = [choice for choice in others if choice.group == "Disagreements"]
    assert len(apart) == DISAGREEMENTS
    assert len({choice.task for choice in chosen}) == len(chosen)
    assert {choice.right for choice in apart} == {"two", "three"}  # they take turns
    assert all(choice.left == "one" for choice in apart)
    two = [choice for choice in apart if choice.right == "two"]
    gaps = [int(re.findall(r"(\d+) s slower", choice.why)[0]) for choice in two]
    assert gaps == sorted(gaps, reverse=True)
    assert [choice.task for choice in two] == gaps  # two takes one second more per task


def test_choice__of_equal_policies_has_no_disagreement() -> None:
    rows = {name: [_row(name, task, 30.0) for task in range(5)] for name in ("one", "two")}
    assert {choice.group for choice in choose(["one", "two"], rows, PAPER)} == {"Typical"}


BROKEN = {"outcome": "error", "modes": "", "time_s": 0.0, "intervals": 0, "phase": 1,
          "d_min": math.inf, "cost_integral": 0.0, "error": "ValueError: <no> luck"}  # fmt: skip
POOR = {
    "one policy": {"analytic": rows_of("analytic")},
    "one task": {"analytic": rows_of("analytic")[:1], "random": rows_of("random")[:1]},
    "no success": {
        "random": [row for row in rows_of("random") if row["outcome"] != "success"],
        "analytic": [rows_of("analytic")[row["task"]] for row in rows_of("random")
                     if row["outcome"] != "success"],
    },
    "skid alone": {"skid": rows_of("skid")},
    "errors only": {"analytic": [{**row, **BROKEN} for row in rows_of("analytic")]},
    "errors beside": {
        "analytic": rows_of("analytic"),
        "random": [{**row, **BROKEN, "policy": "random"} for row in rows_of("random")],
    },
}  # fmt: skip


@pytest.mark.parametrize("case", POOR)
def test_poor_results__still_make_a_page(case: str) -> None:
    rows = {name: own for name, own in POOR[case].items() if own}
    outline = Outline(page := page_of(rows))
    for name, own in rows.items():
        solved = sum(row["outcome"] == "success" for row in own)
        assert any(row[1] == f"{solved}/{len(own)}" for row in outline.rows(name) if len(row) > 1)
    assert not re.search(r'\b(d="[^"]*|[xyr][12]?="|c[xy]=")(nan|inf)', page)
    if "errors" in case:
        assert "ValueError: <no> luck" in outline.text
    assert data_of(page)["episodes"]


def test_other_robots__have_their_own_number_of_joints(tmp_path: Path) -> None:
    params = SnakeParams.preset("hardware", n_joints=6)
    suite = random_suite(2, 1, params)
    rows = {"analytic": evaluated("analytic", suite, params)}
    summary = summary_of(rows, params)
    path = write_report(tmp_path, ["analytic"], rows, summary, params, suite)
    outline = Outline(page := path.read_text(encoding="utf-8"))
    assert outline.rows("the paper") == []  # its figures are another robot's
    data = data_of(page)
    assert data["robot"]["n_joints"] == 6
    assert data["robot"]["frame_s"] == pytest.approx(0.2)  # the robot's own sampling time
    assert [episode["name"] for episode in data["episodes"]] != ["sim-1"]  # it has 8 joints
    assert "Fig. 5" not in outline.text
    for run in data["episodes"][0]["runs"]:
        motion = motion_of(rows["analytic"][0], suite.initial(0, params), params)
        assert decode_angles(run["phi"], 6).shape[1] == motion.phi.shape[1] == 6
    changed = [attributes for _, attributes in outline.tags if attributes.get("class") == "changed"]
    assert len(changed) == sum(
        value != PAPER.__dict__[name] for name, value in params.__dict__.items()
    )


def test_frames__are_a_tenth_of_a_second_apart_where_the_robot_allows() -> None:
    assert frame_steps(PAPER) == 5
    assert frame_steps(SnakeParams(dt=0.2)) == 1
    assert frame_steps(SnakeParams(dt=0.05)) == 2


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0, 100, [0, 50, 100]),
        (97.2, 100, [98, 99, 100]),
        (0, 0, [0]),
        (1, 1.2, [1, 1.05, 1.1, 1.15, 1.2]),
    ],
)
def test_ticks__are_round(low: float, high: float, expected: list[float]) -> None:
    assert svg.round_ticks(low, high, 4) == pytest.approx(expected)


def test_scales__map_their_ends() -> None:
    for scale in (
        svg.linear(2.0, 8.0, 10.0, 40.0), svg.logarithmic(2.0, 8.0, 10.0, 40.0)
    ):  # fmt: skip
        assert (scale(2.0), scale(8.0)) == (pytest.approx(10.0), pytest.approx(40.0))
    assert svg.logarithmic(1.0, 100.0, 0.0, 2.0)(10.0) == pytest.approx(1.0)
    assert svg.linear(3.0, 3.0, 1.0, 2.0)(3.0) == 1.0  # an axis of no length
    zero = svg.log_from_zero(99.0, 0.0, 2.0)
    assert (zero(0.0), zero(99.0), zero(9.0)) == (0.0, pytest.approx(2.0), pytest.approx(1.0))


def test_tags__escape_texts_and_attributes() -> None:
    made = svg.tag("text", "a < b", svg.tag("tspan", "&"), class_="x", aria_label='"', hidden=None)
    assert made == '<text class="x" aria-label="&quot;">a &lt; b<tspan>&amp;</tspan></text>'


def test_profile__rises_to_the_share_of_solved_tasks() -> None:
    rows = _many()
    entries = [
        charts.Entry(name, k, summarise(own, [], PAPER), None)
        for k, (name, own) in enumerate(rows.items())
    ]
    paths = re.findall(
        r'<path d="M([^"]+)" class="curve hue-(\d)"', charts.profile_chart(entries, rows)
    )
    tops = {}
    for path, style in paths:
        heights = [float(point.split(",")[1]) for point in path.split("L")]
        assert heights == sorted(heights, reverse=True)  # y points downwards
        tops[int(style)] = heights[-1]
    bottom, top = 234.0, 28.0
    shares = {style: (bottom - y) / (bottom - top) for style, y in tops.items()}
    assert shares == pytest.approx({0: 1.0, 1: 39 / 40, 2: 0.5}, abs=0.002)


def _entry(
    style: int, solved: int, ratio: dict[str, float] | None, p95: float = 2e3
) -> charts.Entry:
    figures = {
        "success_rate": solved / 100,
        "wilson95": wilson95(solved, 100),
        "rollouts_per_decision": 10.0 * style,
        "decision_latency_us": {"p50": 0.5 * p95, "p95": p95},
    }
    return charts.Entry(f"policy {style}", style, figures, ratio)


def test_charts__point_to_what_lies_beyond_their_axes() -> None:
    entries = [
        _entry(0, 99, {"mean": 1.0}),
        _entry(1, 97, {"mean": 0.9, "low": 0.8, "high": 1.1}),
        _entry(2, 20, {"mean": 3.0, "low": 2.0, "high": 4.0}),
        _entry(3, 98, None),
    ]
    for chart, shown in (
        (charts.success_chart(entries, None), 3),
        (charts.ratio_chart(entries), 2),
        (charts.time_cost_chart(entries), 2),
        (charts.rollouts_chart(entries), 3),
        (charts.latency_chart(entries, paper=False), 3),
    ):
        arrows = re.findall(r'hue-(\d)"><g transform="rotate', chart)
        assert arrows == ["2"]
        assert chart.count("marker") == shown + len(arrows)
    assert "95 % 0.800 to 1.100" in charts.ratio_chart(entries)


def test_charts__of_poor_policies_leave_none_out() -> None:
    entries = [_entry(0, 30, {"mean": 1.0}), _entry(1, 20, {"mean": 3.0})]
    assert "rotate" not in charts.success_chart(entries, None) + charts.ratio_chart(entries)


def test_latencies__are_in_milliseconds_beside_the_papers() -> None:
    entries = [_entry(0, 99, None, p95=1e3), _entry(1, 99, None, p95=150e3)]
    chart = charts.latency_chart(entries, paper=True)
    assert "paper 0.15 s" in chart
    (limit,) = re.findall(r'<line x1="([\d.]+)" x2="\1" y1="28" y2="210" class="limit"', chart)
    places = re.findall(r"translate\(([\d.]+) [\d.]+\)", chart)
    assert float(places[1]) == float(limit) > float(places[0])


def test_short_names__keep_their_end() -> None:
    assert charts.short("imitate") == "imitate"
    assert (
        charts.short("runs/imitate-paper-s0/best.safetensors+shield") == "\u2026afetensors+shield"
    )
