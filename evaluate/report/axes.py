"""Axes of the charts, and lines without needless points."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from evaluate.report.svg import WIDTH, Scale, Ticks, labelled, round_ticks, tag, y_axis


def titled_y_axis(scale: Scale, ticks: Ticks, title: str) -> list[Markup]:
    """Grid lines, and a title above them."""
    return [*y_axis(scale, ticks, 48.0, WIDTH - 18.0), tag("text", title, x=4.0, y=12.0)]


def percent_ticks(low: float) -> Ticks:
    """Ticks up to 100 %, from a rate that may be far above 0."""
    return labelled(round_ticks(low, 100.0, 4))


def corners(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """A staircase without the points inside its steps."""
    kept = list(points[:1])
    for k, point in enumerate(points[1:], start=1):
        last = k == len(points) - 1
        inside = not last and (
            points[k - 1][0] == point[0] == points[k + 1][0]
            or points[k - 1][1] == point[1] == points[k + 1][1]
        )
        if not inside:
            kept.append(point)
    return kept
