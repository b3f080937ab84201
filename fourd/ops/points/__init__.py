"""The point compositor of ``csrc/points``: CPU, CUDA and a plain torch reference."""
