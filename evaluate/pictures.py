"""Pictures to put into a text: the paper's Fig. 4, and its Fig. 5 with a filmstrip for ``sim-1``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evaluate.protocol import Row, Shard, chooses_modes, run_shard
from evaluate.replay import Replay, replay, slip_of
from harness.figures import Figure, matplotlib, save, style
from harness.files import file_name
from snake_env.errors import InvalidInputError
from snake_env.params import SnakeParams
from snake_env.rendering.drawing import (
    BODY,
    GRAVITY,
    GROUNDED,
    INK,
    LIFTED,
    SUPPORT,
    TARGET,
    draw_robot,
    geometry,
)
from snake_env.sim.tasks import load_tasks

_STYLE: dict[str, Any] = {
    "font.size": 9,
    "axes.edgecolor": BODY,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "savefig.dpi": 130,
}
_FRAMES = 8
_MARGIN = 0.12  # around the robot [m]


def draw_all(
    folder: Path,
    rows: Mapping[str, Sequence[Row]],
    params: SnakeParams,
    decision_timeout_s: float | None = None,
) -> None:
    """Draws each policy's Fig. 4, and Fig. 5 and the filmstrip for the first that chooses modes."""
    with style(_STYLE):
        for policy, own in rows.items():
            save(figure_4(policy, own, params), folder / f"fig4-{file_name(policy)}.png")
        choosing = [policy for policy in rows if chooses_modes(policy)]
        if choosing and _has_sim_1(params):
            policy = choosing[0]
            state = load_tasks("sim-1", params).initial(0, params)
            slip = slip_of(rows[policy][0])
            row = run_shard(Shard(policy, [0], [state], params, decision_timeout_s, slip))[0]
            if row["modes"]:
                played = replay(row, state, params)
                name = file_name(policy)
                save(figure_5(policy, played, params), folder / f"sim-1-traces-{name}.png")
                save(filmstrip(policy, played, params), folder / f"sim-1-film-{name}.png")


def _has_sim_1(params: SnakeParams) -> bool:
    """Whether simulation 1's shapes are shapes of this robot."""
    try:
        load_tasks("sim-1", params)
    except InvalidInputError:
        return False
    return True


def figure_4(policy: str, rows: Sequence[Row], params: SnakeParams) -> Figure:
    """Fig. 4 of the paper: largest joint angle, least distance and duration of every task."""
    figure = Figure(figsize=(9, 6.4), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    tasks = np.array([row["task"] for row in rows])
    solved = np.array([row["outcome"] == "success" for row in rows])
    panels = (
        ("max_abs_phi", r"max $|\phi|$ [rad]", params.phi_limit, "joint limit"),
        ("d_min", r"$d_\min$ [m]", params.d_touch, "links touch"),
        ("time_s", "time [s]", params.horizon_s, "horizon"),
    )
    for ax, (key, label, limit, meaning) in zip(axes, panels, strict=True):
        values = np.array([row[key] for row in rows], dtype=np.float64)
        ax.plot(tasks[solved], values[solved], ".", color=GROUNDED, ms=4, label="success")
        if not solved.all():
            ax.plot(
                tasks[~solved], values[~solved], "x", color=LIFTED, ms=6, mew=1.5, label="failure"
            )
        ax.axhline(limit, color=INK, lw=0.8, ls=(0, (5, 4)))
        ax.annotate(
            meaning, (1.0, limit), xycoords=("axes fraction", "data"), xytext=(-2, 2),
            textcoords="offset points", ha="right", va="bottom", color=INK, fontsize=8,
        )  # fmt: skip
        ax.set_ylabel(label)
        ax.margins(x=0.01)
    axes[0].set_ylim(top=params.phi_limit * 1.12)
    axes[0].set_ylim(bottom=min(axes[0].get_ylim()[0], params.phi_limit * 0.8))
    axes[1].set_ylim(bottom=0.0)
    axes[2].set_ylim(0.0, params.horizon_s * 1.12)
    axes[2].set_xlabel("task")
    figure.legend(*axes[2].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    figure.suptitle(
        f"{policy}: {solved.sum()} of {len(rows)} tasks solved (compare Fig. 4 of the paper)",
        x=0.01, ha="left", fontsize=11, parse_math=False,
    )  # fmt: skip
    return figure


def figure_5(policy: str, played: Replay, params: SnakeParams) -> Figure:
    """Fig. 5 of the paper: head pose, joint angles and inputs over time; phases and lifted wheels."""
    n = params.n_joints
    times = np.concatenate(
        [s.elapsed + m.t[:-1] for s, m in zip(played.states, played.motions, strict=False)]
    )
    end = played.states[-1]
    ends = np.append(times, end.elapsed)
    phi = np.concatenate([*(motion.phi[:-1] for motion in played.motions), end.phi[None]])
    w = np.concatenate([*(motion.w[:-1] for motion in played.motions), end.w[None]])
    u = np.concatenate([motion.u for motion in played.motions])
    target = played.states[0].target
    figure = Figure(figsize=(11, 12), layout="constrained")
    grid = figure.add_gridspec(n // 2 + 2, 4, height_ratios=[1.5] + [1] * (n // 2) + [1.2])
    band = figure.add_subplot(grid[0, :])
    _mode_band(band, played, params)
    for k in range(n):
        row, column = 1 + k // 2, 2 * (k % 2)
        left = figure.add_subplot(grid[row, column], sharex=band)
        left.plot(ends, phi[:, k], color=GROUNDED, lw=1.3)
        left.axhline(target[k], color=TARGET, lw=1, ls=":")
        for sign in (-1, 1):
            left.axhline(sign * params.phi_limit, color=LIFTED, lw=0.9, ls=(0, (5, 3)))
        left.set_ylim(-1.15 * params.phi_limit, 1.15 * params.phi_limit)
        left.set_ylabel(rf"$\phi_{k + 1}$ [rad]")
        right = figure.add_subplot(grid[row, column + 1], sharex=band)
        right.plot(times, u[:, k], color=INK, lw=1)
        for sign in (-1, 1):
            right.axhline(sign * params.u_limit, color=LIFTED, lw=0.9, ls=(0, (5, 3)))
        right.set_ylim(-1.15 * params.u_limit, 1.15 * params.u_limit)
        right.set_ylabel(f"$u_{k + 1}$ [rad/s]")
    last = figure.add_subplot(grid[-1, :], sharex=band)
    names = ("$x_0$ [m]", "$y_0$ [m]", r"$\theta_0 - \pi$ [rad]")
    for axis, (name, colour) in enumerate(zip(names, (GROUNDED, TARGET, GRAVITY), strict=True)):
        last.plot(
            ends, w[:, axis] - params.w_d[axis], lw=1.6 - 0.4 * axis, color=colour, label=name
        )
    last.set_ylim(-0.1, 0.1)
    last.set_ylabel("head error")
    last.set_xlabel("time [s]")
    last.legend(ncols=3, loc="upper right")
    figure.suptitle(
        f"sim-1 by {policy} (compare Fig. 5): broken lines are limits, dotted lines targets",
        x=0.01, ha="left", fontsize=11, parse_math=False,
    )  # fmt: skip
    return figure


def _mode_band(ax: Any, played: Replay, params: SnakeParams) -> None:
    """Which wheels are in the air over time, and the phases."""
    n = params.n_joints
    duration = played.states[-1].elapsed
    room = duration / 16  # what a label needs
    labelled = -room
    for k, (state, motion) in enumerate(zip(played.states, played.motions, strict=False)):
        span = (state.elapsed, float(motion.t[-1]))
        for wheel, up in enumerate(played.lifted(k, params), start=1):
            scp = wheel == state.phase
            colour = INK if scp else LIFTED if up else SUPPORT
            ax.broken_barh(
                [span], (wheel - 0.42, 0.84), facecolor=colour, edgecolor="white", lw=0.6
            )
        if k == 0 or played.states[k - 1].phase != state.phase:
            ax.axvline(state.elapsed, color=INK, lw=0.8, ls=":")
            if state.elapsed - labelled < room or duration - state.elapsed < room:
                continue
            labelled = state.elapsed
            ax.annotate(
                f"phase {state.phase}", (state.elapsed, n + 0.75), fontsize=8, color=INK,
                xytext=(2, 0), textcoords="offset points", annotation_clip=False,
            )  # fmt: skip
    ax.set_ylim(0.4, n + 1.4)
    ax.set_yticks(range(1, n + 1))
    ax.set_ylabel("wheel")
    ax.set_xlim(0.0, duration)
    ax.xaxis.set_major_locator(matplotlib.ticker.MaxNLocator(7))
    handles = [
        matplotlib.patches.Patch(color=colour, label=label)
        for colour, label in ((INK, "SCP (lifted)"), (LIFTED, "lifted"), (SUPPORT, "grounded"))
    ]
    ax.legend(handles=handles, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))


def filmstrip(policy: str, played: Replay, params: SnakeParams) -> Figure:
    """The body at moments spread evenly over the episode."""
    count = min(_FRAMES, len(played.modes) + 1)
    chosen = np.unique(np.linspace(0, len(played.modes), count).round().astype(int))
    columns = 4
    rows = -(-len(chosen) // columns)
    states = [played.states[k] for k in chosen]
    outlines = [geometry(s.phi, s.w, params).outline for s in states]
    outlines.append(geometry(states[0].target, np.array(params.w_d), params).outline)
    points = np.concatenate(outlines)
    low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    frame_height = 2.5 * (high - low)[1] / (high - low)[0] + 0.45
    figure = Figure(figsize=(11, frame_height * rows + 0.9), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for ax, k, state in zip(axes, chosen, states, strict=False):
        interval = min(int(k), len(played.modes) - 1)
        up = (
            np.zeros(params.n_joints, dtype=np.bool_)
            if state.done
            else played.lifted(interval, params)
        )
        draw_robot(ax, state.phi, state.w, up, params, state.target)
        what = "target reached" if state.done else f"phase {state.phase}"
        ax.set_title(f"{state.elapsed:.0f} s, {what}")
        ax.set_xlim(low[0], high[0])
        ax.set_ylim(low[1], high[1])
        ax.tick_params(labelsize=7)
    for ax in axes[len(chosen) :]:
        ax.set_visible(False)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=6)
    figure.suptitle(
        f"sim-1 by {policy}: the head stays where it is (axes in m)",
        x=0.01, ha="left", fontsize=11, parse_math=False,
    )  # fmt: skip
    return figure


def _legend() -> list[Any]:
    line = matplotlib.lines.Line2D
    return [
        line([], [], color=INK, marker="o", ls="", ms=7, label="head"),
        line([], [], color=GROUNDED, marker="s", lw=1.6, label="grounded wheels"),
        line([], [], color=LIFTED, marker="s", mfc="white", ls=":", label="lifted wheels"),
        matplotlib.patches.Patch(facecolor=SUPPORT, edgecolor=GROUNDED, alpha=0.5, label="support"),
        line([], [], color=GRAVITY, marker="P", mec=INK, ls="", ms=9, label="centre of gravity"),
        line([], [], color=TARGET, ls="--", label="target shape"),
    ]
