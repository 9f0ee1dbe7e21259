"""Matplotlib figures that only ever become files: any backend and any style of the user's may be set.

``MPLBACKEND`` may name a backend that is not installed here (notebooks set it for what they start), and
Matplotlib then refuses to be imported. Files are drawn by Agg, which is always there.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from snake_env.system.files import write_atomically

_named = os.environ.pop("MPLBACKEND", None)
try:
    import matplotlib
    import matplotlib.ticker
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
finally:
    if _named is not None:
        os.environ["MPLBACKEND"] = _named

__all__ = ["Figure", "matplotlib", "save", "style"]


@contextmanager
def style(own: dict[Any, Any]) -> Iterator[None]:
    """Figures that are drawn and saved within it look like Matplotlib's own, but for ``own``."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(own)
        yield


def save(figure: Figure, path: Path) -> None:
    """Writes a figure as PNG, atomically."""
    content = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(content, format="png")
    write_atomically(path, content.getvalue())
