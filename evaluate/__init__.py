"""``python -m evaluate``: runs policies on the same tasks and compares them."""

import snake_env  # noqa: F401  # takes interrupts before anything else is imported
