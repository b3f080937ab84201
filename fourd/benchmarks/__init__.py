"""Speed of kernels and stages, against their references and against other programs found installed."""
