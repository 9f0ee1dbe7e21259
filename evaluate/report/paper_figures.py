"""The paper's Figs. 4 and 5 as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from markupsafe import Markup

from evaluate.protocol import Row
from evaluate.report.motion import Motion, frame_steps
from evaluate.report.svg import (
    Scale,
    dots,
    drawing,
    labelled,
    line,
    linear,
    round_ticks,
    tag,
    x_axis,
    y_axis,
)
from snake_env.params import SnakeParams
from snake_env.state import FloatArray

_LEFT, _TOP, _BOTTOM = 40.0, 12.0, 178.0
_JOINT_WIDTH = 260.0
_PANEL_WIDTH = 330.0


@dataclass(frozen=True)
class Panel:
    """One of Fig. 4's panels.

    Attributes:
        title: What it shows.
        chart: The SVG.
    """

    title: str
    chart: Markup


def figure_4(policy: str, rows: Sequence[Row], params: SnakeParams) -> list[Panel]:
    """Fig. 4: largest joint angle, least distance and duration of every task."""
    return [
        Panel(title, _panel(f"{policy}: {title}", rows, key, limit, name))
        for title, key, limit, name in (
            ("largest joint angle, max |\u03c6| [rad]", "max_abs_phi", params.phi_limit, "limit"),
            ("least distance, d_min [m]", "d_min", params.d_touch, "links touch"),
            ("time [s]", "time_s", params.horizon_s, "horizon"),
        )
    ]


def _panel(title: str, rows: Sequence[Row], key: str, limit: float, limit_name: str) -> Markup:
    known = [row for row in rows if isfinite(row[key])]
    highest = 1.08 * max([limit, *(row[key] for row in known)])
    lowest = 0.7 * limit if key == "max_abs_phi" else 0.0
    lowest = min([lowest, *(row[key] for row in known)])
    right = _PANEL_WIDTH - 6.0
    x_scale = linear(0, max(1, len(rows) - 1), _LEFT + 8, right - 4)
    y_scale = linear(lowest, highest, _BOTTOM, _TOP)
    parts = [
        *y_axis(y_scale, labelled(round_ticks(lowest, highest, 4)), _LEFT, right),
        *x_axis(x_scale, labelled(_whole(len(rows))), _BOTTOM, _BOTTOM, "task", _PANEL_WIDTH),
        tag("line", x1=_LEFT, x2=right, y1=y_scale(limit), y2=y_scale(limit), class_="limit"),
        tag("text", limit_name, x=right, y=y_scale(limit) - 5, text_anchor="end", class_="limit"),
    ]
    for solved, class_ in ((True, "dots"), (False, "dots failed")):
        points = [
            (x_scale(k), y_scale(row[key]))
            for k, row in enumerate(rows)
            if (row["outcome"] == "success") == solved and isfinite(row[key])
        ]
        if points:
            parts.append(dots(points, class_))
    return drawing(title, _BOTTOM + 40, parts, _PANEL_WIDTH)


def _whole(count: int) -> list[float]:
    """Ticks at tasks, which have whole numbers."""
    return [tick for tick in round_ticks(0, max(1, count - 1), 5) if tick == int(tick)]


def figure_5(motion: Motion, target: FloatArray, params: SnakeParams) -> list[Markup]:
    """Fig. 5, a chart for each joint: its angle above, its input below.

    Args:
        motion: The episode.
        target: Target joint angles, shape (n,) [rad].
        params: The constants.
    """
    every = frame_steps(params)
    inputs = np.diff(motion.phi, axis=0) / params.dt
    end = (len(motion.phi) - 1) * params.dt
    charts = []
    for joint in range(params.n_joints):
        shown = [interval for interval, phase in enumerate(motion.phases) if phase == joint + 1]
        x_scale = linear(0.0, end, 44.0, _JOINT_WIDTH - 8)
        parts: list[Markup] = []
        if shown:
            x0 = x_scale(shown[0] * params.delta_t)
            x1 = x_scale(min(end, (shown[-1] + 1) * params.delta_t))
            parts.append(tag("rect", x=x0, y=8.0, width=x1 - x0, height=172.0, class_="phase"))
        upper = linear(-params.phi_limit, params.phi_limit, 104.0, 14.0)
        lower = linear(-params.u_limit, params.u_limit, 176.0, 124.0)
        parts += _bounds(upper, params.phi_limit) + _bounds(lower, params.u_limit)
        wanted = upper(float(target[joint]))
        parts.append(tag("line", x1=44.0, x2=_JOINT_WIDTH - 8, y1=wanted, y2=wanted, class_="goal"))
        for scale, values in ((upper, motion.phi[::every, joint]), (lower, inputs[::every, joint])):
            points = [
                (x_scale(k * every * params.dt), scale(float(v))) for k, v in enumerate(values)
            ]
            parts.append(line(points, "trace"))
        parts += x_axis(x_scale, labelled(round_ticks(0.0, end, 4)), 180.0, 180.0)
        names = (
            tag("text", "\u03c6", _sub(joint + 1), x=4.0, y=63.0, class_="name"),
            tag("text", "u", _sub(joint + 1), x=4.0, y=154.0, class_="name"),
        )
        title = f"Joint {joint + 1}: angle and input over time"
        charts.append(drawing(title, 204.0, [*parts, *names], _JOINT_WIDTH))
    return charts


def _bounds(scale: Scale, limit: float) -> list[Markup]:
    """Broken lines at a limit and its opposite, with their values."""
    parts = [tag("line", x1=44.0, x2=_JOINT_WIDTH - 8, y1=scale(0), y2=scale(0), class_="grid")]
    for value in (-limit, limit):
        y = scale(value)
        parts.append(tag("line", x1=44.0, x2=_JOINT_WIDTH - 8, y1=y, y2=y, class_="limit"))
        parts.append(
            tag("text", f"{value:.2g}".replace("-", "\u2212"), x=40.0, y=y + 4, text_anchor="end")
        )
    return parts


def _sub(index: int) -> Markup:
    return tag("tspan", str(index), dy="3", font_size="9")
