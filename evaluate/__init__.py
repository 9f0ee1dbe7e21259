"""``python -m evaluate``: runs policies on the same tasks and compares them."""
