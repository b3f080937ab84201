"""The unknowns of a rig's calibration, the observed corners, and the projection with its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fourd.base.cameras import Camera
from fourd.recording.board_calibration.detection import BoardView
from fourd.recording.boards import CalibrationBoard

Array = NDArray[np.float64]

POSE, LENS, TIME = slice(0, 6), slice(6, 15), slice(15, 17)
"""Indices of a camera's pose (rotation, translation), lens (fx, fy, cx, cy, k1, k2, p1, p2, k3) and timing (delay,
readout) in the vector of its parameters."""
PARAMETERS = 17
"""Number of parameters per camera."""
BOARD_PARAMETERS = 6
"""Number of parameters per pose of the board: rotation, translation."""
MIN_DEPTH = 1e-6


@dataclass(frozen=True, eq=False)
class Corners:
    """N observed corners of a board.

    Attributes:
        camera: (N,) indices of the cameras.
        board: (N,) indices of the board's poses, one pose per frame.
        xyz: (N, 3) corners in board coordinates, in metres.
        pixels: (N, 2) observed positions in pixels of the distorted images.
        ids: (N,) numbers of the corners on the board.
        back: (N,) whether the corner is on the back of a double-sided board.
    """

    camera: NDArray[np.intp]
    board: NDArray[np.intp]
    xyz: Array
    pixels: Array
    ids: NDArray[np.intp]
    back: NDArray[np.bool_]

    def select(self, kept: NDArray[np.bool_]) -> Corners:
        """Select the corners for which the mask (N,) is true."""
        return Corners(
            self.camera[kept], self.board[kept], self.xyz[kept], self.pixels[kept], self.ids[kept], self.back[kept]
        )


@dataclass(frozen=True, eq=False)
class Poses:
    """M rigid motions x -> R x + t.

    Attributes:
        rotation: (M, 3, 3) matrices R.
        translation: (M, 3) vectors t in metres.
    """

    rotation: Array
    translation: Array

    def __len__(self) -> int:
        return len(self.rotation)

    def __getitem__(self, which: slice | int | NDArray[np.intp] | Sequence[int]) -> Poses:
        index = slice(which, which + 1) if isinstance(which, int) else which
        return Poses(self.rotation[index], self.translation[index])

    def after(self, first: Poses) -> Poses:
        """Return the composed motions, which apply ``first`` before the motions of this object."""
        return Poses(
            self.rotation @ first.rotation,
            (self.rotation @ first.translation[..., None])[..., 0] + self.translation,
        )

    def inverse(self) -> Poses:
        """Return the inverse motions."""
        back = np.swapaxes(self.rotation, 1, 2)
        return Poses(back, -(back @ self.translation[..., None])[..., 0])


@dataclass(frozen=True, eq=False)
class Timing:
    """The time at which each camera sees each row of its images. The object also stores the board's motion, from which
    the board's pose at this time is computed.

    A corner at the phase q of the readout is seen at the time ``f + delay + q * readout`` in frames, where f is the
    frame number. The phase is -0.5 at one edge of the sensor, 0 in its middle and 0.5 at the opposite edge.

    Attributes:
        delay: (C,) delays, in frames, of the row in the middle of the image.
        readout: (C,) durations of the readout in frames. A duration is negative if the last row is read first.
        phase: (C, 2) gradient of the phase per pixel along x and y. If the sensor's rows are the image's rows, the
            gradient is (0, 1 / height). If the image was turned by 90 degrees, the gradient is (1 / width, 0).
        motion: (F, 6) motion at each position of the board, in world coordinates: the rotation vector per frame, and
            the velocity of the board's origin in metres per frame. An adjustment does not change the motions.
    """

    delay: Array
    readout: Array
    phase: Array
    motion: Array

    def offsets(self, corners: Corners) -> Array:
        """Return the times (N,) at which corners are seen, in frames relative to the time of the corner's frame."""
        return self.delay[corners.camera] + self.readout[corners.camera] * self.phases(corners)

    def phases(self, corners: Corners) -> Array:
        """Return the readout phase (N,) of each corner: -0.5 at one edge of the sensor, 0.5 at the opposite edge."""
        return np.asarray(np.einsum("ni,ni->n", corners.pixels, self.phase[corners.camera]) - 0.5)


@dataclass(frozen=True, eq=False)
class BoardShape:
    """Differences between a real board and a flat, regular board in the plane z = 0.

    Attributes:
        offsets_m: (K, 3) displacements of the corners of a board that is not exactly flat or not exactly regular.
        thickness_m: distance between the front and the back of a double-sided board. The back is at z = -thickness.
    """

    offsets_m: Array
    thickness_m: float


@dataclass(frozen=True, eq=False)
class RigState:
    """Cameras and positions of the board.

    Attributes:
        cameras: C cameras with poses from world to camera.
        boards: F poses from board to world at the times of the frames.
        timing: times at which the cameras see the corners, or None if all cameras see all rows at the frame's time.
        shape: shape of the board, or None for a flat and regular board of no thickness.
    """

    cameras: tuple[Camera, ...]
    boards: Poses
    timing: Timing | None = None
    shape: BoardShape | None = None

    @property
    def camera_poses(self) -> Poses:
        """C poses from world to camera."""
        return Poses(
            np.stack([camera.rotation for camera in self.cameras]),
            np.stack([camera.translation for camera in self.cameras]),
        )


@dataclass(frozen=True, eq=False)
class Projection:
    """Projections of N corners.

    Attributes:
        pixels: (N, 2) projections with lens distortion.
        depth: (N,) depths in metres.
        by_camera: (N, 2, 17) derivatives with respect to the parameters of each corner's camera.
        by_board: (N, 2, 6) derivatives with respect to the pose of the board that ``Corners.board`` selects for the
            corner.
        by_corner: (N, 2, 3) derivatives with respect to the corner's position on the board.
        by_time: (N, 2) derivatives with respect to the time of each corner, in pixels per frame.
    """

    pixels: Array
    depth: Array
    by_camera: Array
    by_board: Array
    by_corner: Array
    by_time: Array


def collect_corners(board: CalibrationBoard, views: Sequence[BoardView], frames: Sequence[int]) -> Corners:
    """Collect the corners of the views in ``frames``. The index of a board's pose is the index of its frame in
    ``frames``."""
    index = {frame: number for number, frame in enumerate(frames)}
    used = [view for view in views if view.frame in index]
    counts = [len(view.corners) for view in used]
    ids = np.concatenate([view.corners for view in used] or [np.zeros(0, np.intp)])
    return Corners(
        np.repeat(np.array([view.camera for view in used], np.intp), counts),
        np.repeat(np.array([index[view.frame] for view in used], np.intp), counts),
        board.corners[ids],
        np.concatenate([view.pixels for view in used] or [np.zeros((0, 2))]),
        ids,
        np.repeat(np.array([view.back for view in used], bool), counts),
    )


def project(state: RigState, corners: Corners) -> Projection:
    """Project corners, with derivatives.

    A rotation's parameters are a rotation vector w that is applied from the left: R -> exp([w]x) R. Depths below 1e-6 m
    are replaced by 1e-6 m before the perspective division.
    """
    count = len(corners.camera)
    turn_board = state.boards.rotation[corners.board]
    on_board = (turn_board @ _shaped(state, corners)[..., None])[..., 0]
    world = on_board + state.boards.translation[corners.board]
    velocity = np.zeros((count, 3))
    turn_motion = np.broadcast_to(np.eye(3), (count, 3, 3))
    if state.timing is not None:
        motion, offsets = state.timing.motion[corners.board], state.timing.offsets(corners)
        turn_motion = Rotation.from_rotvec(motion[:, :3] * offsets[:, None]).as_matrix()
        on_board = (turn_motion @ on_board[..., None])[..., 0]
        world = on_board + state.boards.translation[corners.board] + motion[:, 3:] * offsets[:, None]
        velocity = np.cross(motion[:, :3], on_board) + motion[:, 3:]
    poses = state.camera_poses
    turn = poses.rotation[corners.camera]
    turned = (turn @ world[..., None])[..., 0]
    in_camera = turned + poses.translation[corners.camera]
    pixels, by_point, by_lens = _apply_lenses(state.cameras, corners.camera, in_camera)
    by_world = by_point @ turn
    by_time = (by_world @ velocity[..., None])[..., 0]
    by_camera = np.zeros((count, 2, PARAMETERS))
    # The derivative of exp([w]x) @ p with respect to w at w = 0 is -[p]x, where [p]x is the cross-product matrix of p.
    by_camera[..., :3] = by_point @ -cross_matrices(turned)
    by_camera[..., 3:6] = by_point
    by_camera[..., LENS] = by_lens
    if state.timing is not None:
        by_camera[..., TIME.start] = by_time
        by_camera[..., TIME.start + 1] = by_time * state.timing.phases(corners)[:, None]
    by_board = np.concatenate([by_world @ -cross_matrices(on_board) @ turn_motion, by_world], axis=2)
    return Projection(pixels, in_camera[:, 2], by_camera, by_board, by_world @ turn_motion @ turn_board, by_time)


def _shaped(state: RigState, corners: Corners) -> Array:
    """Return the positions (N, 3) of corners on a board that need not be flat."""
    if state.shape is None:
        return corners.xyz
    xyz = corners.xyz + state.shape.offsets_m[corners.ids]
    xyz[:, 2] -= state.shape.thickness_m * corners.back
    return xyz


def _apply_lenses(cameras: Sequence[Camera], camera: NDArray[np.intp], in_camera: Array) -> tuple[Array, Array, Array]:
    """Return the pixels (N, 2) of points, and two arrays of derivatives of the pixels: (N, 2, 3) with respect to the
    points, and (N, 2, 9) with respect to the lenses."""
    count = len(in_camera)
    safe = in_camera.copy()
    safe[:, 2] = np.maximum(in_camera[:, 2], MIN_DEPTH)
    pixels, by_point, by_lens = np.zeros((count, 2)), np.zeros((count, 2, 3)), np.zeros((count, 2, 9))
    for index, each in enumerate(cameras):
        rows = np.flatnonzero(camera == index)
        if not len(rows):
            continue
        distortion = np.zeros(5) if each.distortion is None else each.distortion
        found, jacobian = cv2.projectPoints(safe[rows], np.zeros(3), np.zeros(3), each.intrinsics, distortion)
        jacobian = np.asarray(jacobian).reshape(len(rows), 2, -1)
        pixels[rows] = np.asarray(found).reshape(-1, 2)
        by_point[rows] = jacobian[..., 3:6]
        lens = jacobian[..., 6:15]
        by_lens[rows, :, : lens.shape[-1]] = lens
    return pixels, by_point, by_lens


def reprojection_errors(state: RigState, corners: Corners) -> Array:
    """Return the distances (N,), in pixels, between the projected and the observed corners. The distance of a corner
    behind its camera is infinite."""
    found = project(state, corners)
    return np.where(found.depth > MIN_DEPTH, np.linalg.norm(found.pixels - corners.pixels, axis=1), np.inf)


def lens_vector(camera: Camera) -> Array:
    """Return a camera's lens as an array (9,): fx, fy, cx, cy, k1, k2, p1, p2, k3. Further coefficients are left
    out."""
    k, distortion = camera.intrinsics, np.zeros(5)
    if camera.distortion is not None:
        distortion[: min(5, len(camera.distortion))] = camera.distortion[:5]
    return np.concatenate([[k[0, 0], k[1, 1], k[0, 2], k[1, 2]], distortion])


def cross_matrices(vectors: Array) -> Array:
    """Return the cross-product matrices (N, 3, 3) of the vectors (N, 3). The cross-product matrix M of a vector v
    satisfies M @ u = v x u for every vector u."""
    x, y, z = vectors.T
    matrices = np.zeros((len(vectors), 3, 3))
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
    matrices[:, 1, 0], matrices[:, 2, 0], matrices[:, 2, 1] = z, -y, x
    return matrices
