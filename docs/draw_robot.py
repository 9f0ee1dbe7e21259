"""Draws ``docs/images/robot.svg``, the robot with its parts named: ``python docs/draw_robot.py``."""

from __future__ import annotations

import math
from pathlib import Path

PHI = (0.5, -0.9, -0.5, 0.6, 0.7, -0.4, -0.6, 0.5)  # joint angles [rad]
SCP, MODE = 3, (5, 7)  # the phase's joint; the rear wheels that the mode lifts
SCALE, L, TRACK = 520.0, 0.091, 0.10
INK, SOFT, GREEN, RED, BLUE = "#2b3138", "#6b7680", "#0b6e4f", "#c8324a", "#2f6fb5"
Point = tuple[float, float]


def main() -> None:
    """Writes the drawing."""
    file = Path(__file__).parent / "images" / "robot.svg"
    file.write_text(drawing(), encoding="utf-8")


def drawing() -> str:
    """The drawing, as SVG."""
    joints, wheels, links = robot()
    body = [line(a, b, "#8a949e", 9) for a, b in links]
    for k, (centre, heading) in enumerate(wheels, 1):
        body += wheel(k, centre, heading, RED if k == SCP or k in MODE else GREEN)
    for k, (x, y) in enumerate(joints, 1):
        fill, ink = (INK, "white") if k == SCP else ("white", INK)
        body.append(
            f'<circle cx="{x}" cy="{y}" r="10" fill="{fill}" stroke="{INK}" stroke-width="2"/>'
        )
        body.append(text(str(k), (x, y + 4.5), ink, "middle", 13))
    (x, y), _ = links[0]
    body.append(f'<circle cx="{x}" cy="{y}" r="9" fill="white" stroke="{BLUE}" stroke-width="4"/>')
    first, last = joints[SCP - 1], wheels[-1][0]
    body += callout(("the head stays still",), (x, y - 12), (20, 76))
    body += callout(("link 0", "has no wheels"), (x + 48, y + 6), (64, 236))
    body += callout(
        ("joint 3 turns now:", "the SCP of phase 3"), (first[0], first[1] - 12), (250, 40)
    )
    body += callout(("the mode lifts", "wheels 5 and 7"), up(wheels[4][0]), (440, 70))
    body += callout(("a wheel on the ground", "rolls and cannot slip"), up(wheels[5][0]), (590, 70))
    body += callout(
        ("wheel 3 is lifted", "with its joint"),
        (wheels[2][0][0] - 22, wheels[2][0][1] + 46),
        (205, 276),
    )
    body += brace(joints[0][0], joints[1][0], "phases 1 and 2", "at their targets")
    body += brace(first[0], first[0], "phase 3", "now")
    body += brace(joints[3][0], last[0], "phases 4 to 8", "their wheels are the choice")
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 860 410" font-family="sans-serif" '
        'font-size="15" stroke-linecap="round">\n'
        '<rect width="860" height="410" rx="6" fill="white"/>\n' + "\n".join(body) + "\n</svg>\n"
    )


def robot() -> tuple[list[Point], list[tuple[Point, float]], list[tuple[Point, Point]]]:
    """Joints, wheels with their headings, and links, on the drawing."""
    heading, x, y = math.pi, 0.0, 0.0
    joints, wheels, links = [], [], []
    for k in range(len(PHI) + 1):
        heading += PHI[k - 1] if k else 0.0
        dx, dy = math.cos(heading), math.sin(heading)
        end = (x - 2 * L * dx, y - 2 * L * dy)
        links.append((place((x, y)), place(end)))
        if k:
            joints.append(place((x, y)))
            wheels.append((place((x - L * dx, y - L * dy)), heading))
        x, y = end
    return joints, wheels, links


def place(point: Point) -> Point:
    """A point of the plane [m] on the drawing."""
    return round(50 + SCALE * point[0], 1), round(175 - SCALE * point[1], 1)


def up(point: Point) -> Point:
    """Above a wheel."""
    return point[0], point[1] - 36


def wheel(k: int, centre: Point, heading: float, colour: str) -> list[str]:
    """An axle with its two wheels and its number."""
    (x, y), reach, half = centre, SCALE * TRACK / 2, 12.0
    across, along = (math.sin(heading), math.cos(heading)), (math.cos(heading), -math.sin(heading))
    ends = [(x + s * reach * across[0], y + s * reach * across[1]) for s in (-1, 1)]
    parts = [line(*ends, colour, 2)]
    for ex, ey in ends:
        begin = (ex - half * along[0], ey - half * along[1])
        parts.append(line(begin, (ex + half * along[0], ey + half * along[1]), colour, 8))
    lowest = max(ends, key=lambda end: end[1])
    return [*parts, text(str(k), (lowest[0], lowest[1] + 24), colour, "middle", 13)]


def line(a: Point, b: Point, colour: str, width: float) -> str:
    """A line between two points of the drawing."""
    ends = f'x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}"'
    return f'<line {ends} stroke="{colour}" stroke-width="{width}"/>'


def text(words: str, at: Point, colour: str = INK, anchor: str = "start", size: int = 15) -> str:
    """Words."""
    where = f'x="{at[0]:.1f}" y="{at[1]:.1f}" text-anchor="{anchor}"'
    return f'<text {where} fill="{colour}" font-size="{size}">{words}</text>'


def callout(rows: tuple[str, ...], target: Point, at: Point) -> list[str]:
    """Rows of words with a line to what they name."""
    above = at[1] < target[1]
    begin = (target[0], at[1] + 18 * len(rows) - 12 if above else at[1] - 18)
    rows_at = [(at[0], at[1] + 18 * row) for row in range(len(rows))]
    return [
        line(begin, target, SOFT, 1),
        *(text(*pair) for pair in zip(rows, rows_at, strict=True)),
    ]


def brace(left: float, right: float, *rows: str) -> list[str]:
    """A bracket under a part of the robot, with rows of words."""
    y, middle = 350.0, (left + right) / 2
    parts = [line((left - 12, y), (right + 12, y), INK, 2)]
    parts += [line((x, y), (x, y - 7), INK, 2) for x in (left - 12, right + 12)]
    return parts + [
        text(row, (middle, y + 22 + 19 * k), INK, "middle") for k, row in enumerate(rows)
    ]


if __name__ == "__main__":
    main()
