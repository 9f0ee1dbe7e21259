"""Small helpers for charts in SVG: elements, scales, axes. Colours are the page's CSS variables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from html import escape

from markupsafe import Markup

Scale = Callable[[float], float]
"""Where a value lies in the drawing."""
Ticks = Sequence[tuple[float, str]]
"""Values on an axis with their labels."""

WIDTH = 440.0
_MARKERS = (
    "M-4,0a4,4 0 1,0 8,0a4,4 0 1,0 -8,0Z",  # circle
    "M-3.6,-3.6H3.6V3.6H-3.6Z",  # square
    "M0,-4.6L4.4,3.4H-4.4Z",  # triangle
    "M0,-5L5,0L0,5L-5,0Z",  # diamond
    "M0,4.6L4.4,-3.4H-4.4Z",  # triangle upside down
    "M-1.5,-4.6H1.5V-1.5H4.6V1.5H1.5V4.6H-1.5V1.5H-4.6V-1.5H-1.5Z",  # plus
    "M-5,-3H5V3H-5Z",  # bar
    "M-3,-5H3V5H-3Z",  # pillar
)
_DASHES = ("none", "7 3", "2 2.5", "9 3 2 3", "4 2", "12 4", "1.5 4", "6 2 1.5 2 1.5 2")
COLOURS = len(_MARKERS)


def tag(name: str, *children: str, **attributes: object) -> Markup:
    """An element; texts among its children and attributes are escaped, markup is not.

    An underscore in an attribute's name stands for a hyphen; one at its end is dropped. Attributes
    that are None are left out.
    """
    words = [name]
    for key, value in attributes.items():
        if value is None:
            continue
        text = number(value) if isinstance(value, float) else str(value)
        words.append(f'{key.rstrip("_").replace("_", "-")}="{escape(text)}"')
    inside = Markup("").join(children)
    return Markup(f"<{' '.join(words)}>{inside}</{name}>")


def number(value: float) -> str:
    """A coordinate: a tenth of a pixel is enough."""
    return f"{value:.1f}".removesuffix(".0")


def drawing(title: str, height: float, children: Iterable[str], width: float = WIDTH) -> Markup:
    """A whole chart; its title is what a screen reader says."""
    return tag(
        "svg",
        *children,
        viewBox=f"0 0 {number(width)} {number(height)}",
        role="img",
        aria_label=title,
        xmlns="http://www.w3.org/2000/svg",
    )


def linear(low: float, high: float, start: float, stop: float) -> Scale:
    """Values from ``low`` to ``high``, drawn from ``start`` to ``stop``."""
    span = (high - low) or 1.0
    return lambda value: start + (stop - start) * (value - low) / span


def logarithmic(low: float, high: float, start: float, stop: float) -> Scale:
    """The same for positive values, by their logarithm."""
    inner = linear(math.log(low), math.log(high), start, stop)
    return lambda value: inner(math.log(value))


def log_from_zero(high: float, start: float, stop: float) -> Scale:
    """Values from 0 on: nearly linear up to 1, logarithmic beyond."""
    inner = linear(0.0, math.log1p(high), start, stop)
    return lambda value: inner(math.log1p(value))


def round_ticks(low: float, high: float, count: int = 5) -> list[float]:
    """About ``count`` round values between two bounds."""
    rough = max(high - low, 1e-9) / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = power * next(factor for factor in (1, 2, 5, 10) if factor * power >= rough)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [round(k * step, 10) for k in range(first, last + 1)]


def labelled(values: Iterable[float]) -> Ticks:
    """Ticks whose labels are the values."""
    return [(value, f"{value:g}") for value in values]


def x_axis(
    scale: Scale, ticks: Ticks, top: float, bottom: float, title: str = "", width: float = WIDTH
) -> list[Markup]:
    """Grid lines from ``top`` to ``bottom``, labels under them, the axis's title at its right end."""
    parts = []
    for value, label in ticks:
        x = scale(value)
        parts.append(tag("line", x1=x, x2=x, y1=top, y2=bottom, class_="grid"))
        parts.append(tag("text", escape(label), x=x, y=bottom + 16, text_anchor="middle"))
    if title:
        parts.append(
            tag("text", title, x=width - 6, y=bottom + 34, text_anchor="end", class_="axis")
        )
    return parts


def y_axis(scale: Scale, ticks: Ticks, left: float, right: float) -> list[Markup]:
    """Grid lines from ``left`` to ``right`` with labels before them."""
    parts = []
    for value, label in ticks:
        y = scale(value)
        parts.append(tag("line", x1=left, x2=right, y1=y, y2=y, class_="grid"))
        parts.append(tag("text", escape(label), x=left - 6, y=y + 4, text_anchor="end"))
    return parts


def marker(x: float, y: float, style: int, title: str) -> Markup:
    """A policy's point; the title shows when the pointer rests on it."""
    shape = tag("path", tag("title", title), d=_MARKERS[style % COLOURS], class_="marker")
    return tag("g", shape, transform=f"translate({number(x)} {number(y)})", class_=hue(style))


def arrow(x: float, y: float, style: int, title: str, turn: int = 0, label: str = "") -> Markup:
    """A policy that lies beyond an axis: an arrow to the left, turned clockwise by some degrees."""
    shape = tag("path", tag("title", title), d="M-2,0L7,-5V5Z", class_="marker")
    turned = tag("g", shape, transform=f"rotate({turn})")
    words = tag("text", label, x=9.0, y=4.0)
    return tag(
        "g", turned, words, transform=f"translate({number(x)} {number(y)})", class_=hue(style)
    )


def whisker(x0: float, y0: float, x1: float, y1: float, style: int) -> Markup:
    """A policy's interval."""
    return tag("line", x1=x0, y1=y0, x2=x1, y2=y1, class_=f"whisker {hue(style)}")


def line(points: Iterable[tuple[float, float]], class_: str, style: int | None = None) -> Markup:
    """A line through points, with a policy's colour and dashes where it has a ``style``."""
    path = "L".join(f"{number(x)},{number(y)}" for x, y in points)
    dashes = None if style is None else _DASHES[style % COLOURS]
    colour = "" if style is None else f" {hue(style)}"
    return tag("path", d=f"M{path}", class_=class_ + colour, stroke_dasharray=dashes)


def dots(points: Iterable[tuple[float, float]], class_: str) -> Markup:
    """Many points in one path: each a line of no length, drawn by its round caps."""
    places = dict.fromkeys(f"M{round(x)},{round(y)}h0" for x, y in points)
    return tag("path", d="".join(places), class_=class_)


def hue(style: int) -> str:
    """The CSS class that gives a policy its colour."""
    return f"hue-{style % COLOURS}"


def key(style: int) -> Markup:
    """A policy's colour, dashes and marker, for the legend."""
    return tag(
        "svg",
        line([(1, 7), (31, 7)], "curve", style),
        tag("g", tag("path", d=_MARKERS[style % COLOURS], class_="marker"),
            transform="translate(16 7)", class_=hue(style)),
        viewBox="0 0 32 14", width=32, height=14, aria_hidden="true",
    )  # fmt: skip
