"""Initial values of a rig's calibration: lenses, poses of the board in each view, and poses of the cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.board_calibration.adjustment.rig import Poses, RigState, collect_corners, reprojection_errors
from fourd.recording.board_calibration.detection import BoardView
from fourd.recording.boards import CalibrationBoard
from fourd.recording.capture.layout import sample_indices

Array = NDArray[np.float64]

MAX_LENS_VIEWS = 40
"""Maximum number of views from which an initial lens is estimated.

This limits the computing time; the bundle adjustment uses all views.
"""
MAX_PAIR_FRAMES = 60
"""Maximum number of frames from which the relative pose of two cameras is chosen."""
FOCAL_GUESSES = (0.6, 1.0, 1.6)
"""Initial focal lengths that are tried, as fractions of the image's longer side."""
BAD_VIEW = 3.0
"""A view is not used to estimate the initial lens if its error exceeds this multiple of the median error."""
AGREEMENT_M = 0.1
"""When relative poses are compared, a distance of this many metres has the same weight as an angle of 0.1 radians."""
MAX_ERROR_PX = 30.0
"""Upper limit, in pixels, to which reprojection errors are clamped when poses of the board are compared."""


@dataclass(frozen=True, eq=False)
class LocatedView:
    """A view, and the poses of the board that fit the board's corners in this view.

    Attributes:
        view: the view.
        poses: one or two poses from board to camera, the better one first. The corners of a small planar board often
            fit two poses.
    """

    view: BoardView
    poses: Poses


@dataclass(frozen=True, eq=False)
class CameraPair:
    """The relative pose of two cameras.

    Attributes:
        first, second: indices of the cameras.
        pose: one pose, from the second camera's coordinates to the first camera's coordinates.
        frames: number of frames in which both cameras see the board.
    """

    first: int
    second: int
    pose: Poses
    frames: int


def initial_lens(board: CalibrationBoard, views: Sequence[BoardView], width: int, height: int) -> Camera:
    """Estimate a lens with one focal length and one distortion coefficient from views of a board.

    The principal point is fixed at the image's centre, until bundle adjustment estimates it. The pose is the identity.
    """
    chosen = [views[index] for index in sample_indices(len(views), MAX_LENS_VIEWS)]
    best, error = _fit_lens(board, chosen, width, height)
    kept = [view for view, px in zip(chosen, error, strict=True) if px <= BAD_VIEW * float(np.median(error))]
    if len(kept) < len(chosen):
        best, _ = _fit_lens(board, kept, width, height)
    return best


def locate_views(board: CalibrationBoard, cameras: Sequence[Camera], views: Sequence[BoardView]) -> list[LocatedView]:
    """Compute the poses of the board in each view. Views without a pose in front of the camera are left out."""
    located = []
    for view in views:
        camera = cameras[view.camera]
        xyz = board.corners[view.corners]
        found = cv2.solvePnPGeneric(
            xyz, view.pixels, camera.intrinsics, camera.distortion, flags=cv2.SOLVEPNP_IPPE, reprojectionError=None
        )
        motions = []
        for rvec, tvec in zip(found[1], found[2], strict=True):
            refined = cv2.solvePnPRefineLM(xyz, view.pixels, camera.intrinsics, camera.distortion, rvec, tvec)
            rotation, translation = np.asarray(cv2.Rodrigues(refined[0])[0]), np.ravel(refined[1])
            if np.isfinite(translation).all() and ((xyz @ rotation.T + translation)[:, 2] > 0).all():
                motions.append((rotation, translation))
        if motions:
            rotations, translations = zip(*motions, strict=True)
            located.append(LocatedView(view, Poses(np.stack(rotations), np.stack(translations))))
    return located


def pair_cameras(located: Sequence[LocatedView]) -> list[CameraPair]:
    """Compute the relative poses of all pairs of cameras that see the board in the same frame."""
    by_camera: dict[int, dict[int, LocatedView]] = {}
    for each in located:
        by_camera.setdefault(each.view.camera, {})[each.view.frame] = each
    pairs = []
    for first, second in combinations(sorted(by_camera), 2):
        shared = sorted(by_camera[first].keys() & by_camera[second].keys())
        if shared:
            used = [shared[index] for index in sample_indices(len(shared), MAX_PAIR_FRAMES)]
            pose = _relative_pose([(by_camera[first][frame], by_camera[second][frame]) for frame in used])
            pairs.append(CameraPair(first, second, pose, len(shared)))
    return pairs


def join_cameras(count: int, pairs: Sequence[CameraPair]) -> list[list[int]]:
    """Return the connected components of the graph of cameras, in which each camera pair is an edge. The largest
    component comes first."""
    groups = [[index] for index in range(count)]
    for pair in pairs:
        first, second = (next(g for g in groups if index in g) for index in (pair.first, pair.second))
        if first is not second:
            first.extend(second)
            groups.remove(second)
    return sorted((sorted(group) for group in groups), key=len, reverse=True)


def chain_poses(count: int, pairs: Sequence[CameraPair]) -> Poses:
    """Return the poses from the first camera's coordinates to the coordinates of each of the ``count`` cameras, chained
    along the pairs with the most shared frames.

    The chains form a maximum spanning tree (Prim's algorithm). The pairs must connect all cameras.
    """
    poses: dict[int, Poses] = {0: Poses(np.eye(3)[None], np.zeros((1, 3)))}
    while len(poses) < count:
        border = [pair for pair in pairs if (pair.first in poses) != (pair.second in poses)]
        best = max(border, key=lambda pair: pair.frames)
        if best.first in poses:
            poses[best.second] = best.pose.inverse().after(poses[best.first])
        else:
            poses[best.first] = best.pose.after(poses[best.second])
    return Poses(
        np.concatenate([poses[index].rotation for index in range(count)]),
        np.concatenate([poses[index].translation for index in range(count)]),
    )


def initial_boards(
    board: CalibrationBoard, cameras: tuple[Camera, ...], located: Sequence[LocatedView], frames: Sequence[int]
) -> Poses:
    """Return the pose of the board in the world for each frame. Each view of the frame gives one or two poses, and the
    pose that best fits the views of all cameras is chosen."""
    rotations, translations = [], []
    by_frame: dict[int, list[LocatedView]] = {frame: [] for frame in frames}
    for each in located:
        if each.view.frame in by_frame:
            by_frame[each.view.frame].append(each)
    for frame, some in by_frame.items():
        candidates = []
        corners = collect_corners(board, [each.view for each in some], [frame])
        for each in some:
            camera = cameras[each.view.camera]
            to_world = Poses(camera.rotation[None], camera.translation[None]).inverse()
            for number in range(len(each.poses)):
                motion = to_world.after(each.poses[number])
                errors = reprojection_errors(RigState(cameras, motion), corners)
                candidates.append((float(np.minimum(errors, MAX_ERROR_PX).mean()), motion))
        best = min(candidates, key=lambda candidate: candidate[0])[1]
        rotations.append(best.rotation)
        translations.append(best.translation)
    return Poses(np.concatenate([np.zeros((0, 3, 3)), *rotations]), np.concatenate([np.zeros((0, 3)), *translations]))


def views_by_camera(views: Sequence[BoardView], count: int) -> Mapping[int, list[BoardView]]:
    """Return the views of each of ``count`` cameras, in the order of the frames."""
    found: dict[int, list[BoardView]] = {index: [] for index in range(count)}
    for view in sorted(views, key=lambda view: view.frame):
        found[view.camera].append(view)
    return found


def _fit_lens(
    board: CalibrationBoard, views: Sequence[BoardView], width: int, height: int
) -> tuple[Camera, NDArray[np.float64]]:
    """Fit a lens with the best of several initial focal lengths. Returns the lens and the views' errors in pixels."""
    xyz = [board.corners[view.corners].astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    flags = (
        cv2.CALIB_USE_INTRINSIC_GUESS
        | cv2.CALIB_FIX_ASPECT_RATIO
        | cv2.CALIB_FIX_PRINCIPAL_POINT
        | cv2.CALIB_ZERO_TANGENT_DIST
        | cv2.CALIB_FIX_K2
        | cv2.CALIB_FIX_K3
    )
    trials = []
    for guess in FOCAL_GUESSES:
        focal = guess * max(width, height)
        k = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
        rms, k, distortion, *_, errors = cv2.calibrateCameraExtended(
            xyz, pixels, (width, height), k, np.zeros(5), flags=flags
        )
        if np.isfinite(rms) and k[0, 0] > 0:
            lens = Camera(np.asarray(k, float), np.eye(3), np.zeros(3), width, height, np.asarray(distortion, float))
            trials.append((rms, lens, np.asarray(errors, np.float64).ravel()))
    _, best, best_errors = min(trials, key=lambda trial: trial[0])
    return best, best_errors


def _relative_pose(shared: Sequence[tuple[LocatedView, LocatedView]]) -> Poses:
    """Return the relative pose of two cameras: of all candidates, the one that agrees best with the candidates of the
    other frames.

    Each frame gives up to four candidates, because each view has up to two poses. The difference between
    two candidates is the sum of the angle and the weighted distance (:data:`AGREEMENT_M`) between them. For each
    candidate, the difference from the most similar candidate of every frame is computed. The candidate whose
    differences have the smallest median over the frames is chosen.
    """
    candidates, frame = [], []
    for number, (first, second) in enumerate(shared):
        for i in range(len(first.poses)):
            for j in range(len(second.poses)):
                candidates.append(first.poses[i].after(second.poses[j].inverse()))
                frame.append(number)
    rotation = np.concatenate([each.rotation for each in candidates])
    translation = np.concatenate([each.translation for each in candidates])
    cosines = (np.einsum("aij,bij->ab", rotation, rotation) - 1) / 2
    angles = np.arccos(np.clip(cosines, -1, 1))
    distances = np.linalg.norm(translation[:, None] - translation[None], axis=2)
    differences = angles + distances * (0.1 / AGREEMENT_M)
    nearest = np.full((len(candidates), len(shared)), np.inf)
    for column, number in enumerate(frame):
        nearest[:, number] = np.minimum(nearest[:, number], differences[:, column])
    best = int(np.argmin(np.median(nearest, axis=1)))
    return candidates[best]
