"""Views of a board by synthetic cameras. The views are projected corners with noise. No images are rendered."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fourd.base.cameras import Camera
from fourd.recording.board_calibration.adjustment.rig import Corners, Poses, RigState, project
from fourd.recording.board_calibration.detection import BoardView
from fourd.recording.board_calibration.fit import RigInput
from fourd.recording.synth.board_videos import BoardSettings, board_path, rig_cameras


@dataclass(frozen=True)
class Filming:
    """Errors of cameras that film a moving board.

    Attributes:
        delays: delay in frames of the middle row of a camera's images, by camera index.
        readout: time in frames from the first to the last row of an image (rolling shutter).
        across: whether the columns of an image are read one after another, instead of the rows, as in videos that were
            turned by 90 degrees.
        jitter: standard deviation of a random delay of each image, in frames.
        thickness_m: thickness of the board in metres.
        backs: indices of the cameras that see the back of the board.
    """

    delays: Mapping[int, float] = field(default_factory=dict)
    readout: float = 0.0
    across: bool = False
    jitter: float = 0.0
    thickness_m: float = 0.0
    backs: tuple[int, ...] = ()


AT_ONCE = Filming()


def flat_corners(xyz: np.ndarray, pixels: np.ndarray | None = None) -> Corners:
    """The corners ``xyz`` (N, 3) of a board, as seen by the first camera in the first frame."""
    zeros = np.zeros(len(xyz), np.intp)
    seen = np.zeros((len(xyz), 2)) if pixels is None else pixels
    return Corners(zeros, zeros, xyz, seen, np.arange(len(xyz)), np.zeros(len(xyz), bool))


def seen_views(
    settings: BoardSettings,
    frames: Iterable[int],
    seen_by: Mapping[int, Iterable[int]] | None = None,
    noise_px: float = 0.05,
    filming: Filming = AT_ONCE,
) -> tuple[list[Camera], list[BoardView]]:
    """The cameras, and one view for each image in which at least 8 corners of the board are visible.

    A camera whose index is a key of ``seen_by`` sees the board only in the frames listed there.
    """
    generator = np.random.default_rng(settings.seed)
    cameras, views = rig_cameras(settings), []
    for index, camera in enumerate(cameras):
        allowed = set(frames if seen_by is None or index not in seen_by else seen_by[index])
        xyz = settings.board.corners - (0, 0, filming.thickness_m * (index in filming.backs))
        for frame in frames:
            time = frame + filming.delays.get(index, 0.0)
            if filming.jitter:
                time += float(generator.normal(0, filming.jitter))
            pixels = _film(settings, camera, xyz, time, filming)
            inside = ((pixels > 0) & (pixels < settings.size)).all(axis=1)
            if frame in allowed and inside.sum() >= 8:
                noisy = pixels + generator.normal(0, noise_px, pixels.shape)
                corners = np.flatnonzero(inside)
                views.append(BoardView(index, frame, corners, noisy[inside], index in filming.backs))
    return cameras, views


def _film(settings: BoardSettings, camera: Camera, xyz: np.ndarray, time: float, filming: Filming) -> np.ndarray:
    """Pixels (N, 2) of corners. Each corner is projected with the pose of the board at the time at which the corner's
    row or column of the image is read."""

    def at(times: np.ndarray) -> np.ndarray:
        corners = replace(flat_corners(xyz), board=np.arange(len(xyz)))
        return project(RigState((camera,), Poses(*board_path(settings, times))), corners).pixels

    pixels = at(np.full(len(xyz), time))
    for _ in range(4 if filming.readout else 0):
        pixels = at(time + filming.readout * (pixels[:, 0 if filming.across else 1] / settings.size - 0.5))
    return pixels


def rig_input(settings: BoardSettings, views: list[BoardView], lenses: list[Camera | None] | None = None) -> RigInput:
    """The input of a fit, with cameras called a, b, c and so on."""
    names = tuple("abcdefgh"[: settings.cameras])
    sizes = ((settings.size, settings.size),) * settings.cameras
    return RigInput("videos", names, sizes, tuple(lenses or [None] * settings.cameras), settings.board, tuple(views))


def largest_differences(found: Iterable[Camera], true: Iterable[Camera]) -> tuple[float, float, float]:
    """The three largest errors of a calibration: of the focal lengths in %, of the relative rotations of camera pairs
    in degrees, and of the relative positions of camera pairs in % of their distance.
    """
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
    """The camera, turned about its own x axis by ``by`` radians."""
    c, s = np.cos(by), np.sin(by)
    matrix = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return replace(camera, rotation=matrix @ camera.rotation, translation=matrix @ camera.translation)
