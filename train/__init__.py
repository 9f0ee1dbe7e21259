"""Training: the command ``python -m train`` is not written yet; ``snake_env.sb3`` trains with SB3."""
