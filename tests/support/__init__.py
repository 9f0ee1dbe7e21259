"""What the tests share."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The checkout."""

HANGS_S = 900.0
"""What takes longer than this hangs [s]: far more than any work here takes, on a busy machine too."""
