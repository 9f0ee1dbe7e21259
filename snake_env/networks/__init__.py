"""Networks without PyTorch: NumPy inference, mirror symmetry, model files."""
