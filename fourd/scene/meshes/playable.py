"""Rendering of meshes, with the captured colours or in a drawing style (:mod:`fourd.scene.styles`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.formats.mesh import Mesh
from fourd.recording.capture.frame_rate import DEFAULT_FPS
from fourd.rendering.ops.stylize.op import stylize_surface
from fourd.scene.meshes.drawing import GeometryBuffer, draw_mesh
from fourd.scene.meshes.smoothing import smooth_normals
from fourd.scene.meshes.source import MeshSource
from fourd.scene.splats.surrounding_cameras import cameras_around
from fourd.scene.styled.player import is_same_camera
from fourd.scene.styles import Style, view_style
from fourd.scene.styles.tables import make_table


class PlayableMeshes:
    """One mesh, or a sequence of meshes, and a ring of cameras around the common bounding box of the first, middle and
    last mesh.

    The class implements :class:`fourd.scene.playable.Playable`. To reduce flicker while the camera does not move, the
    lines of a style fade in, and their thresholds have a hysteresis, as in
    :class:`fourd.scene.styled.player.StyledPlayer`. Unlike in that class, depths and normals are not averaged over
    time.

    Args:
        path: a GLB or PLY file, or a folder with one file for each frame.
        style: the style, or None for the captured colours.

    Raises:
        UserError: if a file is not a valid mesh, or if the style's shade map (image with the colours of the shading)
            cannot be read.
    """

    def __init__(self, path: Path, style: Style | None = None) -> None:
        self._source = MeshSource(path)
        self._style = style
        self._table = None if style is None else make_table(style)
        self._last: tuple[int, Mesh] | None = None
        self._camera: Camera | None = None
        self._lines = np.zeros((0, 0), np.uint32)
        count = len(self._source.frame_numbers)
        meshes = [self._read(index) for index in sorted({0, count // 2, count - 1})]
        lower = np.min([mesh.xyz.min(0) for mesh in meshes], axis=0).astype(np.float64)
        upper = np.max([mesh.xyz.max(0) for mesh in meshes], axis=0).astype(np.float64)
        self.focus: NDArray[np.float64] = (lower + upper) / 2
        diagonal = max(float(np.linalg.norm(upper - lower)), 1e-6)
        cameras = cameras_around(self.focus, diagonal, meshes[0].up)
        self.views = {f"side {index + 1}": camera for index, camera in enumerate(cameras)}
        self.fps = DEFAULT_FPS

    @property
    def bounds(self) -> None:
        """None, because the cameras already frame the meshes."""
        return None

    @property
    def is_whole(self) -> bool:
        return False

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        return self._source.frame_numbers

    def render(
        self, camera: Camera, frame: int, layers: int | None, background: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Render a frame as RGB (H, W, 3) float32 in [0, 1]. ``layers`` has no effect, because meshes are opaque."""
        buffer = self.draw(camera, frame)
        if self._style is None or self._table is None:
            return np.clip(buffer.picture(background), 0, 1).astype(np.float32)
        return self._stylize(buffer, camera, self._style, self._table, background)

    def draw(self, camera: Camera, frame: int) -> GeometryBuffer:
        """Draw the colours, depths and normals of a frame."""
        return draw_mesh(self._read(frame), camera)

    def _stylize(
        self,
        buffer: GeometryBuffer,
        camera: Camera,
        style: Style,
        table: NDArray[np.uint8],
        background: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        size = (camera.height, camera.width)
        rests = self._camera is not None and self._lines.shape == size and is_same_camera(self._camera, camera)
        if not rests:
            self._lines = np.zeros(size, np.uint32)
        self._camera = camera
        red, green, blue = (float(value) for value in background)
        parameters = view_style(style, table, camera, self.focus, (red, green, blue))
        picture = stylize_surface(buffer.surface(), parameters, line_state=self._lines)
        return np.asarray(picture[..., :3] / np.float32(255), np.float32)

    def _read(self, index: int) -> Mesh:
        if self._last is None or self._last[0] != index:
            mesh = self._source.read(index)
            self._last = (index, mesh if self._style is None else smooth_normals(mesh))
        return self._last[1]
