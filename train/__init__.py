"""``python -m train``: trains agents and keeps their runs."""

import snake_env  # noqa: F401  # takes interrupts before anything else is imported
