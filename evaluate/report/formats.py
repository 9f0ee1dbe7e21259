"""Numbers as the page shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

DASH = "\u2013"


def p_value(p: float | None) -> str:
    """A p-value, to three digits."""
    if p is None:
        return DASH
    return "<\u2009.001" if p < 0.001 else f"{p:.3f}"


def estimate(interval: Mapping[str, float] | None, digits: int) -> str:
    """A value with its 95 % interval."""
    if interval is None:
        return DASH
    mean, low, high = (
        f"{interval[key]:.{digits}f}".replace("-", "\u2212") for key in ("mean", "low", "high")
    )
    return f"{mean} ({low} to {high})"


def number(value: float | None, digits: int = 1) -> str:
    """A number; a dash where there is none."""
    if value is None:
        return DASH
    return "0" if value == 0 else f"{value:.{digits}f}"


def milliseconds(value_us: float | None) -> str:
    """A time in milliseconds."""
    if value_us is None:
        return DASH
    value = value_us / 1e3
    return f"{value:.{2 if value < 10 else 1 if value < 100 else 0}f}"


def interval(bounds: Sequence[float]) -> str:
    """A range of shares, in per cent."""
    low, high = bounds
    return f"{100 * low:.1f}{DASH}{100 * high:.1f}"


def constant(value: Any) -> str:
    """A constant of the robot."""
    if isinstance(value, (list, tuple)):
        return ", ".join(constant(part) for part in value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)
