"""Normal equations of a rig, summed over views. A view is one camera's image of the board in one frame.

The unknowns are the C cameras (17 parameters each), the shape of a board with K corners (3 * K + 1 parameters) and the
F poses of the board (6 parameters each). Each view has 7 additional unknowns, the errors that all its corners share
(see :mod:`fourd.board_calibration.adjustment.noise`). Before the views are summed, a Schur complement eliminates these
additional unknowns from the equations of each view.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fourd.board_calibration.adjustment.noise import SHARED, ViewNoise, Views, Weights, shared_derivatives
from fourd.board_calibration.adjustment.rig import BOARD_PARAMETERS, PARAMETERS, Corners, RigState, project

Array = NDArray[np.float64]

CHUNK = 128
"""Number of views whose matrices are in memory at the same time."""


@dataclass(frozen=True, eq=False)
class Free:
    """The unknowns that are adjusted in addition to the poses of the board.

    Attributes:
        cameras: (C, 17) mask of the cameras' parameters, true for those that are adjusted.
        offset_std_m: (K, 3) standard deviations of the prior on the corners' displacements on the board. The mean of
            the prior is 0. K is 0 if displacements are not adjusted.
        thickness: whether the thickness of the board is adjusted.
    """

    cameras: NDArray[np.bool_]
    offset_std_m: Array = field(default_factory=lambda: np.zeros((0, 3)))
    thickness: bool = False

    @property
    def shape_unknowns(self) -> int:
        """Number of parameters of the board's shape."""
        return self.offset_std_m.size + self.thickness


@dataclass(frozen=True, eq=False)
class System:
    """Normal equations of P shared unknowns (cameras, then the board's shape) and F poses of the board.

    Attributes:
        shared: (P, P) matrix of the shared unknowns.
        boards: (F, 6, 6) diagonal blocks of the boards.
        coupling: (F, P, 6) blocks between the shared unknowns and each board.
        rhs_shared: (P,) right-hand side.
        rhs_boards: (F, 6) right-hand side.
        gradients: (F, P) contribution of each frame to the right-hand side of the shared unknowns.
    """

    shared: Array
    boards: Array
    coupling: Array
    rhs_shared: Array
    rhs_boards: Array
    gradients: Array

    def step(self, damping: float) -> tuple[Array, Array]:
        """Solve the damped normal equations, whose diagonals are multiplied by 1 + ``damping``. Returns the steps (P,)
        of the shared unknowns and the steps (F, 6) of the boards."""
        reduced, eliminated = self.reduce(damping)
        rhs = self.rhs_shared - np.einsum("fij,fj->i", eliminated, self.rhs_boards)
        step = np.linalg.solve(reduced, rhs)
        inverse = np.linalg.inv(_damped(self.boards, damping))
        rest = self.rhs_boards - np.einsum("fij,i->fj", self.coupling, step)
        return step, np.einsum("fij,fj->fi", inverse, rest)

    def predicted_decrease(self, shared: Array, boards: Array) -> float:
        """Return the scalar product of a step and the right-hand side. It is a lower bound on the amount by which the
        step decreases the quadratic model of the cost."""
        return float(self.rhs_shared @ shared + np.sum(self.rhs_boards * boards))

    def reduce(self, damping: float) -> tuple[Array, Array]:
        """Return the matrix (P, P) of the reduced normal equations, and the products (F, P, 6) of the coupling blocks
        with the inverse blocks of the boards."""
        eliminated = self.coupling @ np.linalg.inv(_damped(self.boards, damping))
        size = len(self.shared)
        left = np.swapaxes(eliminated, 0, 1).reshape(size, -1)
        right = np.swapaxes(self.coupling, 0, 1).reshape(size, -1)
        return _damped(self.shared, damping) - left @ right.T, eliminated


def build_system(
    state: RigState, corners: Corners, views: Views, free: Free, noise: ViewNoise, weights: Weights
) -> System:
    """Sum the normal equations over the views, without a prior. The rows of fixed parameters contain only zeros."""
    count, boards, extra = len(state.cameras), len(state.boards), free.shape_unknowns
    size = count * PARAMETERS + extra
    found = project(state, corners)
    scale = (np.sqrt(weights.corner) / noise.corner_px[corners.camera])[:, None, None]
    std = noise.shared_std
    columns = np.concatenate(
        [
            found.by_camera * free.cameras[corners.camera][:, None],
            found.by_board,
            (corners.pixels - found.pixels)[..., None],
            shared_derivatives(state, corners, found) * std,
        ],
        axis=2,
    )
    columns *= scale
    by_corner = found.by_corner * scale
    system = System(
        np.zeros((size, size)),
        np.zeros((boards, BOARD_PARAMETERS, BOARD_PARAMETERS)),
        np.zeros((boards, size, BOARD_PARAMETERS)),
        np.zeros(size),
        np.zeros((boards, BOARD_PARAMETERS)),
        np.zeros((boards, size)),
    )
    for start in range(0, len(views.camera), CHUNK):
        which = slice(start, start + CHUNK)
        padded = views.pad(columns, which)
        if extra:
            padded = np.concatenate([_shape_columns(by_corner, corners, views, free, which), padded], axis=2)
        _add_views(system, _eliminate(padded, std, weights.view[which]), views.camera[which], views.board[which], extra)
    # This summand keeps the block of a board without observations from being singular.
    system.boards[:] += 1e-9 * np.eye(BOARD_PARAMETERS)
    return system


def squared_error(
    residual: Array, shared: Array, views: Views, noise: ViewNoise, weights: Weights, scale: Array
) -> float:
    """Return the weighted sum of squares of the residuals (N, 2), minimised over the shared errors of each view.

    ``shared`` (N, 2, 7) are the derivatives with respect to the shared errors. ``scale`` (N,) are the square roots of
    the weights, divided by the standard deviations of the corners.
    """
    flat = float(np.sum((residual * scale[:, None]) ** 2))
    std = noise.shared_std
    if not std.any():
        return flat
    left = views.pad(shared * std * scale[:, None, None])
    right = np.swapaxes(left, 1, 2) @ views.pad((residual * scale[:, None])[..., None])
    gram = np.swapaxes(left, 1, 2) @ left + np.eye(SHARED) * weights.view[:, None, None]
    return flat - float(np.sum(right * np.linalg.solve(gram, right)))


def _eliminate(padded: Array, std: Array, weight: Array) -> Array:
    """Return the Gram matrix of each view's Jacobian and residuals, after elimination of the errors that all corners of
    the view share. The result is an array (V, Q, Q).

    ``padded`` has Q + 7 columns. The last seven belong to the shared errors and are eliminated with a Schur complement.
    """
    kept = padded[..., :-SHARED]
    gram = np.swapaxes(kept, 1, 2) @ kept
    if not std.any():
        return gram
    shared = padded[..., -SHARED:]
    own = np.swapaxes(shared, 1, 2) @ shared + np.eye(SHARED) * weight[:, None, None]
    mixed = np.swapaxes(shared, 1, 2) @ kept
    return np.asarray(gram - np.swapaxes(mixed, 1, 2) @ np.linalg.solve(own, mixed))


def _add_views(system: System, grams: Array, cameras: NDArray[np.intp], boards: NDArray[np.intp], extra: int) -> None:
    """Add the Gram matrices (V, Q, Q) of views to ``system``. The columns of a Gram matrix belong to the unknowns of
    the board's shape, of the camera and of the board's pose, and to the residual."""
    own = slice(extra, extra + PARAMETERS)
    pose = slice(own.stop, own.stop + BOARD_PARAMETERS)
    last, shape = pose.stop, slice(0, extra)
    tail = slice(len(system.shared) - extra, len(system.shared))
    for camera in np.unique(cameras):
        rows = cameras == camera
        place = slice(camera * PARAMETERS, (camera + 1) * PARAMETERS)
        total, some = grams[rows].sum(axis=0), boards[rows]
        system.shared[place, place] += total[own, own]
        system.shared[place, tail] += total[own, shape]
        system.shared[tail, place] += total[shape, own]
        system.shared[tail, tail] += total[shape, shape]
        system.rhs_shared[place] += total[own, last]
        system.rhs_shared[tail] += total[shape, last]
        # A camera sees each position of the board at most once, so no index occurs twice in ``some``. With repeated
        # indices, += would drop summands.
        system.coupling[some, place] += grams[rows, own, pose]
        system.coupling[some, tail] += grams[rows, shape, pose]
        system.boards[some] += grams[rows, pose, pose]
        system.rhs_boards[some] += grams[rows, pose, last]
        system.gradients[some, place] += grams[rows, own, last]
        system.gradients[some, tail] += grams[rows, shape, last]


def _shape_columns(by_corner: Array, corners: Corners, views: Views, free: Free, which: slice) -> Array:
    """Return the columns (V, 2 * M, 3 * K + 1) of the Jacobian that belong to the board's shape."""
    rows = views.rows[which]
    count = len(corners.ids)
    columns = np.zeros((*rows.shape, 2, free.shape_unknowns))
    real = rows < count
    view, place = np.nonzero(real)
    used = rows[real]
    if len(free.offset_std_m):
        for axis in range(3):
            columns[view, place, :, 3 * corners.ids[used] + axis] = by_corner[used, :, axis]
    if free.thickness:
        columns[view, place, :, -1] = -by_corner[used, :, 2] * corners.back[used, None]
    return columns.reshape(len(rows), -1, free.shape_unknowns)


def _damped(blocks: Array, damping: float) -> Array:
    return blocks * (1 + damping * np.eye(blocks.shape[-1]))
