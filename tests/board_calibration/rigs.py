"""Views of a board by synthetic cameras: projected corners with noise, without rendered images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from fourd.board_calibration.detection import BoardView
from fourd.board_calibration.fit import RigInput
from fourd.board_calibration.rig import Corners, Poses, RigState, project
from fourd.cameras import Camera
from fourd.synth.board_videos import BoardSettings, board_pose, rig_cameras


def seen_views(
    settings: BoardSettings,
    frames: Iterable[int],
    seen_by: Mapping[int, Iterable[int]] | None = None,
    noise_px: float = 0.05,
) -> tuple[list[Camera], list[BoardView]]:
    """Cameras, and all corners of the board that are in their images.

    ``seen_by`` limits the frames of some cameras, by the camera's index.
    """
    generator = np.random.default_rng(settings.seed)
    cameras, views = rig_cameras(settings), []
    xyz = settings.board.corners
    for index, camera in enumerate(cameras):
        allowed = set(frames if seen_by is None or index not in seen_by else seen_by[index])
        for frame in frames:
            pose = board_pose(settings, float(frame))
            zeros = np.zeros(len(xyz), np.intp)
            state = RigState((camera,), Poses(pose.rotation[None], pose.translation[None]))
            found = project(state, Corners(zeros, zeros, xyz, np.zeros((len(xyz), 2))))
            inside = ((found.pixels > 0) & (found.pixels < settings.size)).all(axis=1)
            if frame in allowed and inside.sum() >= 8:
                pixels = found.pixels + generator.normal(0, noise_px, found.pixels.shape)
                views.append(BoardView(index, frame, np.flatnonzero(inside), pixels[inside]))
    return cameras, views


def rig_input(settings: BoardSettings, views: list[BoardView], lenses: list[Camera | None] | None = None) -> RigInput:
    """The input of a fit, with cameras called a, b, c and so on."""
    names = tuple("abcdefgh"[: settings.cameras])
    sizes = ((settings.size, settings.size),) * settings.cameras
    return RigInput("videos", names, sizes, tuple(lenses or [None] * settings.cameras), settings.board, tuple(views))


def largest_differences(found: Iterable[Camera], true: Iterable[Camera]) -> tuple[float, float, float]:
    """Largest differences: focal length in %, angle of a pair in degrees, position of a pair in % of the baseline."""
    first, second = list(found), list(true)
    focal = max(
        abs(100 * (a.intrinsics[k, k] / b.intrinsics[k, k] - 1))
        for a, b in zip(first, second, strict=True)
        for k in (0, 1)
    )
    angles, positions = [], []
    for i in range(len(first)):
        for j in range(i):
            (rotation, position), (true_rotation, true_position) = (
                _relative(some[i], some[j]) for some in (first, second)
            )
            cosine = (np.trace(rotation @ true_rotation.T) - 1) / 2
            angles.append(float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))))
            positions.append(100 * float(np.linalg.norm(position - true_position) / np.linalg.norm(true_position)))
    return float(focal), max(angles), max(positions)


def _relative(camera: Camera, reference: Camera) -> tuple[np.ndarray, np.ndarray]:
    rotation = camera.rotation @ reference.rotation.T
    return rotation, camera.translation - rotation @ reference.translation


def turned(camera: Camera, by: float) -> Camera:
    """A camera that is turned about its own x axis by an angle in radians."""
    c, s = np.cos(by), np.sin(by)
    matrix = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return replace(camera, rotation=matrix @ camera.rotation, translation=matrix @ camera.translation)
