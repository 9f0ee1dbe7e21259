"""Draws ``docs/images/robot.svg``, the robot with its parts named: ``python docs/draw_robot.py``."""

from __future__ import annotations

import math
from pathlib import Path

PHI = (0.5, -0.9, -0.5, 0.6, 0.7, -0.4, -0.6, 0.5)  # joint angles [rad]
LIFTED = {3, 5, 7}  # the SCP's wheel and the mode's
SCP = 3
SCALE, L, TRACK = 520.0, 0.091, 0.10
INK, SOFT, GREEN, RED, BLUE = "#2b3138", "#6b7680", "#0b6e4f", "#c8324a", "#2f6fb5"


def main() -> None:
    """Writes the drawing."""
    heading, x, y = math.pi, 0.0, 0.0
    parts: list[str] = []
    joints, centres = [], []
    for k in range(len(PHI) + 1):
        if k:
            heading += PHI[k - 1]
        dx, dy = math.cos(heading), math.sin(heading)
        end = (x - 2 * L * dx, y - 2 * L * dy)
        centre = (x - L * dx, y - L * dy)
        parts.append(line((x, y), end, "#8a949e", 9))
        if k:
            joints.append((x, y))
            centres.append((centre, heading))
        x, y = end
    for k, (centre, angle) in enumerate(centres, 1):
        colour = RED if k in LIFTED else GREEN
        across = (-math.sin(angle), math.cos(angle))
        ends = [
            (centre[0] + s * TRACK / 2 * across[0], centre[1] + s * TRACK / 2 * across[1])
            for s in (-1, 1)
        ]
        parts.append(line(*ends, colour, 2))
        for end in ends:
            along = (0.022 * math.cos(angle), 0.022 * math.sin(angle))
            begin = (end[0] - along[0], end[1] - along[1])
            stop = (end[0] + along[0], end[1] + along[1])
            parts.append(line(begin, stop, colour, 8))
    for k, joint in enumerate(joints, 1):
        px, py = place(joint)
        fill = INK if k == SCP else "white"
        parts.append(
            f'<circle cx="{px}" cy="{py}" r="7" fill="{fill}" stroke="{INK}" stroke-width="2"/>'
        )
    hx, hy = place((0.0, 0.0))
    parts.append(
        f'<circle cx="{hx}" cy="{hy}" r="9" fill="none" stroke="{BLUE}" stroke-width="3"/>'
    )
    for text, (px, py), (tx, ty), anchor in (
        ("head: its pose must not change", place((0.0, 0.0)), (24, 60), "start"),
        ("link 0, without wheels", place((0.09, 0.0)), (24, 250), "start"),
        ("joint 1: reached its target in phase 1", place(joints[0]), (150, 300), "start"),
        ("joint 3 is the SCP of phase 3", place(joints[2]), (330, 36), "start"),
        ("wheel 3, the SCP's own, is lifted", place(centres[2][0]), (470, 330), "start"),
        ("wheels 5 and 7 are lifted by the mode", place(centres[4][0]), (560, 66), "start"),
        ("wheels on the ground roll and do not slip", place(centres[5][0]), (620, 130), "start"),
    ):
        parts.append(
            f'<line x1="{px}" y1="{py}" x2="{tx + 4}" y2="{ty + (6 if ty < py else -14)}" '
            f'stroke="{SOFT}" stroke-width="1"/>'
        )
        parts.append(f'<text x="{tx}" y="{ty}" text-anchor="{anchor}" fill="{INK}">{text}</text>')
    style = 'font-family="sans-serif" font-size="14" stroke-linecap="round"'
    body = "\n".join(parts)
    file = Path(__file__).parent / "images" / "robot.svg"
    file.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 900 350" {style}>\n'
        f'<rect width="900" height="350" fill="white"/>\n{body}\n</svg>\n',
        encoding="utf-8",
    )


def place(point: tuple[float, float]) -> tuple[float, float]:
    """A point of the plane [m] on the drawing."""
    return round(60 + SCALE * point[0], 1), round(170 - SCALE * point[1], 1)


def line(a: tuple[float, float], b: tuple[float, float], colour: str, width: float) -> str:
    """A line between two points of the plane."""
    (x1, y1), (x2, y2) = place(a), place(b)
    return (
        f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke="{colour}" stroke-width="{width}"/>'
    )


if __name__ == "__main__":
    main()
