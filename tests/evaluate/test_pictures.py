"""The pictures of an evaluation, drawn from real episodes and looked into artist by artist."""

import functools
import itertools
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import same_color
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from evaluate.pictures import draw_all, figure_4, figure_5, filmstrip
from evaluate.protocol import Row
from evaluate.replay import Replay, replay
from snake_env.modes import mode_table
from snake_env.rendering.drawing import BODY, INK, LIFTED, SUPPORT
from snake_env.sim.simulation import predict
from snake_env.sim.tasks import random_suite
from snake_env.state import SnakeState
from tests.support import first
from tests.support.evaluations import evaluated
from tests.support.robots import PAPER, all_lifted, random_state, row_of, sim_1_episode

PHASE_3 = mode_table(8).valid(3)


@functools.cache
def _rows(policy: str) -> list[Row]:
    return evaluated(policy, random_suite(8, 3, PAPER))


@functools.cache
def _played() -> Replay:
    states, modes, _ = sim_1_episode()
    return replay(row_of(modes), states[0], PAPER)


@functools.cache
def _figure(name: str) -> Figure:
    if name == "figure 5":
        return figure_5("analytic", _played(), PAPER)
    if name == "filmstrip":
        return filmstrip("analytic", _played(), PAPER)
    return figure_4(name, _rows(name), PAPER)


def _texts(figure: Figure) -> Iterator[tuple[str, Bbox]]:
    """Every text that the renderer is asked for, with the pixels that it takes."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # settles the layout
    drawn: list[Text] = []
    draw = Text.draw
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            Text, "draw", lambda text, renderer: (drawn.append(text), draw(text, renderer))
        )
        canvas.draw()
    for text in drawn:
        if text.get_visible() and text.get_text().strip():
            yield text.get_text(), text.get_window_extent(canvas.get_renderer())


def _crosses(ax: Axes) -> list[Line2D]:
    return [line for line in ax.lines if line.get_marker() == "x"]


@pytest.mark.parametrize("name", ["analytic", "random", "skid", "figure 5", "filmstrip"])
def test_texts__lie_within_the_figure_and_apart(name: str) -> None:
    figure = _figure(name)
    texts = list(_texts(figure))
    assert len(texts) > 20
    for text, box in texts:
        assert figure.bbox.x0 - 1 <= box.x0 <= box.x1 <= figure.bbox.x1 + 1, text
        assert figure.bbox.y0 - 1 <= box.y0 <= box.y1 <= figure.bbox.y1 + 1, text
    for (one, a), (other, b) in itertools.combinations(texts, 2):
        apart = a.x1 <= b.x0 + 1 or b.x1 <= a.x0 + 1 or a.y1 <= b.y0 + 1 or b.y1 <= a.y0 + 1
        assert apart, (one, other)


@pytest.mark.parametrize("policy", ["analytic", "random", "skid"])
def test_figure_4__shows_each_task_in_three_panels(policy: str) -> None:
    rows, figure = _rows(policy), _figure(policy)
    solved = [row["outcome"] == "success" for row in rows]
    assert all(solved) == (policy != "random")
    assert len(figure.axes) == 3
    for ax, key, limit in zip(
        figure.axes, ("max_abs_phi", "d_min", "time_s"), (math.pi / 2, 0.1, 300.0), strict=True
    ):
        dots = ax.lines[0].get_xydata().tolist()
        assert dots == [[r["task"], r[key]] for r, won in zip(rows, solved, strict=True) if won]
        failed = [[r["task"], r[key]] for r, won in zip(rows, solved, strict=True) if not won]
        assert [line.get_xydata().tolist() for line in _crosses(ax)] == ([failed] if failed else [])
        assert any(np.allclose(line.get_ydata(), limit) for line in ax.lines)
        low, high = ax.get_ylim()
        assert all(low <= row[key] <= high for row in rows)
    words = [text for text, _ in _texts(figure)]
    assert any(f"{sum(solved)} of 8 tasks solved" in text for text in words)
    assert ("failure" in words) == (not all(solved))
    assert "success" in words


def test_figure_4__bears_an_episode_that_never_began() -> None:
    """A policy that raises at once: no distance was ever measured."""
    row = {**_rows("analytic")[0], "outcome": "error", "d_min": math.inf, "time_s": 0.0}
    figure = figure_4("broken", [row], PAPER)
    assert [text for text, _ in _texts(figure) if "0 of 1" in text]
    assert len(_crosses(figure.axes[2])) == 1


def test_figure_5__has_a_band_two_panels_per_joint_and_the_head() -> None:
    played, figure = _played(), _figure("figure 5")
    assert len(figure.axes) == 1 + 2 * 8 + 1
    times = np.concatenate(
        [s.elapsed + m.t[:-1] for s, m in zip(played.states, played.motions, strict=False)]
    )
    for k in range(8):
        left, right = figure.axes[1 + 2 * k : 3 + 2 * k]
        for ax, quantity, limit in (
            (left, [motion.phi[:-1, k] for motion in played.motions], math.pi / 2),
            (right, [motion.u[:, k] for motion in played.motions], math.pi / 4),
        ):
            trace = ax.lines[0].get_xydata()
            shown = np.column_stack([times, np.concatenate(quantity)])
            np.testing.assert_array_equal(trace[: len(shown)], shown)
            levels = {round(float(line.get_ydata()[0]), 9) for line in ax.lines[1:]}
            assert {round(limit, 9), round(-limit, 9)} <= levels
            low, high = ax.get_ylim()
            assert low < -limit < limit < high
        targets = [line for line in left.lines if line.get_linestyle() == ":"]
        assert [line.get_ydata()[0] for line in targets] == [played.states[0].target[k]]
    assert len(figure.axes[-1].get_legend().get_texts()) == 3


def test_figure_5__colours_the_band_by_the_wheels() -> None:
    played, band = _played(), _figure("figure 5").axes[0]
    seen: Counter[str] = Counter()
    bars = [c for c in band.collections if isinstance(c, PolyCollection)]
    assert len(bars) == 8 * len(played.modes)
    for bar in bars:
        box = bar.get_paths()[0].get_extents()
        k, wheel = int(box.x0 // 3 + 0.5), round((box.y0 + box.y1) / 2)
        assert (box.x0, box.x1) == (3.0 * k, 3.0 * k + 3.0)
        lifted = all_lifted(played.states[k], played.modes[k])[wheel - 1]
        colour = INK if wheel == played.states[k].phase else LIFTED if lifted else SUPPORT
        assert same_color(bar.get_facecolor()[0], colour)
        seen[colour] += 1
    assert seen[INK] == len(played.modes)
    words = [text for text, _ in _texts(_figure("figure 5"))]
    assert [text for text in words if text.startswith("phase")] == [
        f"phase {k}" for k in range(1, 9)
    ]


def test_filmstrip__shows_the_body_from_start_to_target() -> None:
    played, figure = _played(), _figure("filmstrip")
    frames = [ax for ax in figure.axes if ax.get_visible()]
    assert len(frames) == 8
    titles = [ax.get_title(loc="left") or ax.get_title() for ax in frames]
    assert titles[0] == "0 s, phase 1"
    assert titles[-1] == f"{played.states[-1].elapsed:.0f} s, target reached"
    seconds = [int(title.split()[0]) for title in titles]
    assert seconds == sorted(set(seconds))
    for ax in frames:
        (body,) = [line for line in ax.lines if same_color(line.get_color(), BODY)]
        (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
        assert (body.get_xdata() > x0).all()
        assert (body.get_xdata() < x1).all()
        assert (body.get_ydata() > y0).all()
        assert (body.get_ydata() < y1).all()
        assert ax.get_aspect() == 1.0


@pytest.mark.parametrize("intervals", [1, 2, 5])
def test_short_episode__has_as_many_frames_as_states(intervals: int) -> None:
    states, modes, _ = sim_1_episode()
    played = replay(row_of(modes[:intervals]), states[0], PAPER)
    figure = filmstrip("x", played, PAPER)
    assert sum(ax.get_visible() for ax in figure.axes) == intervals + 1
    assert len(figure_5("x", played, PAPER).axes) == 18


def test_replay__is_the_episode() -> None:
    states, modes, motions = sim_1_episode()
    played = _played()
    assert played.modes == modes
    for state, again in zip(states, played.states, strict=True):
        assert state.phi.tolist() == again.phi.tolist()
        assert (state.phase, state.elapsed) == (again.phase, again.elapsed)
    for motion, again in zip(motions, played.motions, strict=True):
        assert motion.u.tolist() == again.u.tolist()


@pytest.mark.parametrize("violation", ["stability", "joint_limit"])
def test_replay__ends_with_a_violation_where_it_happened(violation: str) -> None:
    def soon_violating(state: SnakeState) -> np.ndarray:
        found = predict(state, PHASE_3, PAPER)
        soon = (found.duration > 0.0) & (found.duration < 2.9)
        return PHASE_3[soon & (found.violation == violation)]

    states = (random_state(seed, PAPER, 3).replace(elapsed=0.0) for seed in range(500))
    state = first(state for state in states if len(soon_violating(state)))
    played = replay(row_of([soon_violating(state)[0]]), state, PAPER)
    (motion,) = played.motions
    assert len(motion.u) < 150
    assert motion.phi[-1].tolist() == played.states[-1].phi.tolist()
    assert (abs(motion.phi[-1]).max() > math.pi / 2 + 1e-6) == (violation == "joint_limit")
    band = figure_5("x", played, PAPER).axes[0]
    assert band.get_xlim() == (0.0, pytest.approx(len(motion.u) * PAPER.dt))


def test_draw_all__draws_for_every_policy_and_the_first_that_chooses(tmp_path: Path) -> None:
    draw_all(tmp_path, {policy: _rows(policy) for policy in ("skid", "random")}, PAPER)
    assert {path.name for path in tmp_path.iterdir()} == {
        *("fig4-skid.png", "fig4-random.png"),
        *("sim-1-traces-random.png", "sim-1-film-random.png"),
    }
