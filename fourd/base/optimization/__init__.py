"""Nonlinear least squares: the Levenberg-Marquardt algorithm, and the Schur complement of its normal equations."""
