"""Normal equations of a rig, summed over views. A view is one camera's image of the board in one frame.

The unknowns are the C cameras (17 parameters each), the shape of a board with K corners (3 * K + 1 parameters) and the
F poses of the board (6 parameters each). Each view has 7 additional unknowns, the errors that all its corners share
(see :mod:`fourd.recording.board_calibration.adjustment.noise`). Before the views are summed, a Schur complement
eliminates these additional unknowns from the equations of each view.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fourd.base.optimization.schur import DenseCoupling, NormalEquations
from fourd.recording.board_calibration.adjustment.noise import SHARED, ViewNoise, Views, Weights, shared_derivatives
from fourd.recording.board_calibration.adjustment.rig import BOARD_PARAMETERS, PARAMETERS, Corners, RigState, project

Array = NDArray[np.float64]
RigEquations = NormalEquations[DenseCoupling]
"""Normal equations of a rig. The kept unknowns are the cameras, then the shape of the board. The blocks of eliminated
unknowns are the poses of the board."""

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


def build_system(
    state: RigState, corners: Corners, views: Views, free: Free, noise: ViewNoise, weights: Weights
) -> tuple[RigEquations, Array]:
    """Sum the normal equations over the views, without a prior. The rows of fixed parameters contain only zeros.

    Returns:
        the normal equations, and the contribution (F, P) of each frame to the right-hand side of the cameras and the
        board's shape.
    """
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
    equations = NormalEquations(
        np.zeros((size, size)),
        np.zeros((boards, BOARD_PARAMETERS, BOARD_PARAMETERS)),
        DenseCoupling(np.zeros((boards, size, BOARD_PARAMETERS))),
        np.zeros(size),
        np.zeros((boards, BOARD_PARAMETERS)),
    )
    gradients = np.zeros((boards, size))
    for start in range(0, len(views.camera), CHUNK):
        which = slice(start, start + CHUNK)
        padded = views.pad(columns, which)
        if extra:
            padded = np.concatenate([_shape_columns(by_corner, corners, views, free, which), padded], axis=2)
        grams = _eliminate(padded, std, weights.view[which])
        _add_views(equations, gradients, grams, views.camera[which], views.board[which], extra)
    # This summand keeps the block of a board without observations from being singular.
    equations.blocks[:] += 1e-9 * np.eye(BOARD_PARAMETERS)
    return equations, gradients


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


def _add_views(
    equations: RigEquations,
    gradients: Array,
    grams: Array,
    cameras: NDArray[np.intp],
    boards: NDArray[np.intp],
    extra: int,
) -> None:
    """Add the Gram matrices (V, Q, Q) of views to ``equations`` and ``gradients``. The columns of a Gram matrix belong
    to the unknowns of the board's shape, of the camera and of the board's pose, and to the residual."""
    own = slice(extra, extra + PARAMETERS)
    pose = slice(own.stop, own.stop + BOARD_PARAMETERS)
    last, shape = pose.stop, slice(0, extra)
    tail = slice(len(equations.kept) - extra, len(equations.kept))
    coupling = equations.coupling.values
    for camera in np.unique(cameras):
        rows = cameras == camera
        place = slice(camera * PARAMETERS, (camera + 1) * PARAMETERS)
        total, some = grams[rows].sum(axis=0), boards[rows]
        equations.kept[place, place] += total[own, own]
        equations.kept[place, tail] += total[own, shape]
        equations.kept[tail, place] += total[shape, own]
        equations.kept[tail, tail] += total[shape, shape]
        equations.rhs_kept[place] += total[own, last]
        equations.rhs_kept[tail] += total[shape, last]
        # A camera sees each position of the board at most once, so no index occurs twice in ``some``. With repeated
        # indices, += would drop summands.
        coupling[some, place] += grams[rows, own, pose]
        coupling[some, tail] += grams[rows, shape, pose]
        equations.blocks[some] += grams[rows, pose, pose]
        equations.rhs_blocks[some] += grams[rows, pose, last]
        gradients[some, place] += grams[rows, own, last]
        gradients[some, tail] += grams[rows, shape, last]


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
