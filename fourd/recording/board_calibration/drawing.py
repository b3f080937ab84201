"""Drawing of a rig: its cameras and the positions of the board, from above and from the side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.files import write_bytes_atomically
from fourd.recording.board_calibration.adjustment.rig import Poses
from fourd.recording.boards import CalibrationBoard

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

PANEL = 640
MARGIN = 60
TITLE = 40
MAX_BOARDS = 60
"""Maximum number of board positions that are drawn."""
FRUSTUM_SHARE = 0.12
"""Length of the drawn cameras, as a fraction of the rig's extent."""
INK, GRID, CAMERA, BOARD = (60, 60, 60), (225, 225, 225), (170, 80, 20), (120, 170, 60)
"""Colours in the order blue, green, red."""


@dataclass(frozen=True)
class _View:
    """A panel of the drawing, which shows the rig along one world axis.

    The attributes except ``title`` have two values: one for the world direction that points right in the panel, and one
    for the world direction that points up.

    Attributes:
        title: title of the panel.
        axes: index of the world axis that is parallel to each direction.
        signs: 1 if the direction is that of the axis, and -1 if it is the opposite direction.
        labels: name of each direction, such as "-y".
    """

    title: str
    axes: tuple[int, int]
    signs: tuple[int, int]
    labels: tuple[str, str]


FLOOR_VIEWS = (
    _View("from above", (0, 1), (1, 1), ("x", "y")),
    _View("from the side", (0, 2), (1, 1), ("x", "z")),
)
CAMERA_VIEWS = (
    _View("from above (axes of the first camera)", (0, 2), (1, 1), ("x", "z")),
    _View("from the side", (2, 1), (1, -1), ("z", "-y")),
)


def draw_rig(
    path: Path, names: Sequence[str], cameras: Sequence[Camera], board: CalibrationBoard, boards: Poses, floor: bool
) -> None:
    """Write a PNG with the cameras and up to 60 positions of the board, from above and from the side.

    Args:
        path: file to write.
        names: the cameras' names.
        cameras: cameras in metres.
        board: the board.
        boards: poses from board to world.
        floor: whether the world is aligned with the floor, so that z points up. If false, the world has the axes of the
            first camera, and y points down.
    """
    width, height = board.size_m
    outline = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])
    step = max(1, -(-len(boards) // MAX_BOARDS))
    quads = [
        outline @ rotation.T + translation
        for rotation, translation in zip(boards.rotation[::step], boards.translation[::step], strict=True)
    ]
    centres = np.stack([camera.centre for camera in cameras])
    everything = np.concatenate([centres, *quads])
    extent = float(np.ptp(everything, axis=0).max())
    canvas = np.full((PANEL + TITLE, 2 * PANEL, 3), 255, np.uint8)
    for number, view in enumerate(FLOOR_VIEWS if floor else CAMERA_VIEWS):
        panel = canvas[TITLE:, number * PANEL : (number + 1) * PANEL]
        to_pixels = _fit_panel(view, everything, extent)
        _draw_grid(panel, view, to_pixels, extent)
        for quad in quads:
            cv2.polylines(panel, [to_pixels(quad)], True, BOARD, 1, cv2.LINE_AA)
        for name, camera in zip(names, cameras, strict=True):
            _draw_camera(panel, name, camera, to_pixels, FRUSTUM_SHARE * extent)
        _put_text(canvas, f"{view.title}, {view.labels[0]} right, {view.labels[1]} up", number * PANEL + MARGIN, 26)
    done, content = cv2.imencode(".png", canvas)
    if not done:
        raise RuntimeError(f"{path}: the image could not be encoded")
    write_bytes_atomically(path, content.tobytes())


@dataclass(frozen=True, eq=False)
class _ToPixels:
    """Maps world points (N, 3) to the pixels of a panel."""

    view: _View
    centre: Array
    scale: float

    def __call__(self, xyz: Array) -> NDArray[np.int32]:
        flat = (np.atleast_2d(xyz)[:, self.view.axes] * self.view.signs - self.centre) * self.scale
        return np.round(np.column_stack([PANEL / 2 + flat[:, 0], PANEL / 2 - flat[:, 1]])).astype(np.int32)


def _fit_panel(view: _View, xyz: Array, extent: float) -> _ToPixels:
    flat = xyz[:, view.axes] * view.signs
    return _ToPixels(view, (flat.min(axis=0) + flat.max(axis=0)) / 2, (PANEL - 2 * MARGIN) / max(extent, 1e-6))


def _draw_grid(panel: Picture, view: _View, to_pixels: _ToPixels, extent: float) -> None:
    """Draw grid lines with a spacing of 1, 2 or 5 times a power of ten in metres, and write the spacing below."""
    power = 10.0 ** np.floor(np.log10(max(extent, 1e-6) / 4))
    spacing = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= extent / 6)
    half = PANEL / 2 / to_pixels.scale
    for axis in range(2):
        first = int(np.ceil((to_pixels.centre[axis] - half) / spacing))
        last = int((to_pixels.centre[axis] + half) / spacing)
        for number in range(first, last + 1):
            at = round((number * spacing - to_pixels.centre[axis]) * to_pixels.scale)
            if axis == 0:
                cv2.line(panel, (PANEL // 2 + at, 0), (PANEL // 2 + at, PANEL), GRID, 1)
            else:
                cv2.line(panel, (0, PANEL // 2 - at), (PANEL, PANEL // 2 - at), GRID, 1)
    _put_text(panel, f"grid {spacing:g} m", 8, PANEL - 10)


def _draw_camera(panel: Picture, name: str, camera: Camera, to_pixels: _ToPixels, length: float) -> None:
    """Draw a camera as a pyramid, with the camera's name. The apex is the camera centre, and the base is the image."""
    corners = np.array([[0, 0], [camera.width, 0], [camera.width, camera.height], [0, camera.height]], np.float64)
    rays = np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(camera.intrinsics).T
    # Rays are scaled to equal lengths, because cameras with wide lenses would otherwise be drawn larger than others.
    rays *= length / np.linalg.norm(rays, axis=1, keepdims=True)
    ends = to_pixels(rays @ camera.rotation + camera.centre)
    top = to_pixels(camera.centre)[0]
    cv2.polylines(panel, [ends], True, CAMERA, 1, cv2.LINE_AA)
    for end in ends:
        cv2.line(panel, _pair(top), _pair(end), CAMERA, 1, cv2.LINE_AA)
    cv2.circle(panel, _pair(top), 4, CAMERA, -1, cv2.LINE_AA)
    _put_text(panel, name, int(top[0]) + 8, int(top[1]) - 8)


def _pair(pixel: NDArray[np.int32]) -> tuple[int, int]:
    return int(pixel[0]), int(pixel[1])


def _put_text(canvas: Picture, text: str, x: int, y: int) -> None:
    safe = text.encode("ascii", "replace").decode()
    cv2.putText(canvas, safe, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, INK, 1, cv2.LINE_AA)
