"""Drawing of baked frames in a style, for real-time playback on the CPU."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.aligned import zeros_aligned
from fourd.rendering.ops.play.op import PointPlayer
from fourd.rendering.ops.stylize.op import stylize_surface
from fourd.rendering.ops.stylize.parameters import Surface, speck_reach
from fourd.rendering.ops.stylize.reference import remove_specks
from fourd.scene.scene import BakedFrame, SceneManifest
from fourd.scene.shade import make_shading
from fourd.scene.styled.normals import FrameNormals
from fourd.scene.styles.styles import Style
from fourd.scene.styles.tables import make_table
from fourd.scene.styles.view import view_style


@dataclass(eq=False)
class _Picture:
    """What :class:`StyledPlayer` keeps of its last image: the visible surface, the lines, the camera and the line
    thickness. The surface and the lines are used to reduce the flicker of the next image."""

    surface: Surface
    lines: NDArray[np.uint32]
    camera: Camera | None = None
    thickness: int = 1


class StyledPlayer:
    """Draws baked frames in a style. An instance is not thread-safe: only one thread may use it.

    The noise of the points makes lines flicker. To reduce the flicker while the camera does not move, depths and
    normals are averaged over successive images, lines fade in, and the thresholds for lines are lower where the
    previous image has a line (hysteresis). No average is computed at pixels whose depth or normal clearly differs from
    the previous image, because a surface moves there. The first image in a style has all its lines at full strength.

    Attributes:
        style_seconds: duration of the stylizer in the last call of :meth:`draw`, without the drawing of the surface.
    """

    def __init__(self) -> None:
        """Raises ImportError if the native module is not built."""
        self._points = PointPlayer()
        self._normals = FrameNormals()
        self._last: _Picture | None = None
        self.style_seconds = 0.0
        self._table: tuple[Style, NDArray[np.uint8]] | None = None

    def draw_surface(
        self,
        frame: BakedFrame,
        camera: Camera,
        manifest: SceneManifest,
        *,
        layers: int | None = None,
        persistence: float = 0.0,
        threads: int = 0,
    ) -> Surface:
        """Draw the visible surface of a frame. The next call overwrites the returned surface.

        Args:
            persistence: weight of the previous surface if the camera has not changed, from 0 to below 1.
            layers, threads: see :meth:`fourd.scene.player.Player.draw`.
        """
        size = (camera.height, camera.width)
        if self._last is None or self._last.surface.size != size:
            self._last = _Picture(Surface.empty(*size), zeros_aligned(size, np.uint32))
        last = self._last
        rests = last.camera is not None and is_same_camera(last.camera, camera)
        if not rests:
            last.lines.fill(0)
        last.camera = camera
        self._points.draw_surface(
            frame.xyz,
            frame.radius,
            frame.density,
            frame.sh,
            frame.blend_weights,
            frame.rgb,
            self._normals.get(frame, manifest),
            make_shading(camera, manifest),
            camera,
            layers=manifest.layers if layers is None else layers,
            near=manifest.near,
            persistence=persistence if rests else 0.0,
            threads=threads,
            out=last.surface,
        )
        return last.surface

    def draw(
        self,
        frame: BakedFrame,
        camera: Camera,
        manifest: SceneManifest,
        style: Style,
        *,
        layers: int | None = None,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        threads: int = 0,
        out: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw a frame in a style as an (H, W, 4) uint8 image. The channels are RGB and alpha. RGB is composited over
        the paper, which is the style's background.

        The arguments are those of :meth:`fourd.scene.player.Player.draw`. ``background`` is the paper colour for
        styles that define no paper. Raises UserError if the style's shade map (image with the colours of the shading)
        cannot be read.
        """
        is_same_style = self._table is not None and self._table[0] == style
        table = self._table_of(style)
        surface = self.draw_surface(
            frame, camera, manifest, layers=layers, persistence=style.persistence, threads=threads
        )
        assert self._last is not None
        if not is_same_style:
            self._last.lines.fill(0)
        started = time.perf_counter()
        parameters = view_style(style, table, camera, manifest.focus, background)
        self._last.thickness = parameters.thickness
        picture = stylize_surface(surface, parameters, line_state=self._last.lines, threads=threads, out=out)
        self.style_seconds = time.perf_counter() - started
        return picture

    @property
    def line_strength(self) -> NDArray[np.uint8]:
        """(H, W) strength of the lines in the last image, without specks (very short lines, which are not drawn)."""
        if self._last is None:
            raise RuntimeError("line_strength: expected a picture, got none; call draw first")
        return remove_specks((self._last.lines & 255).astype(np.uint8), speck_reach(self._last.thickness))

    def _table_of(self, style: Style) -> NDArray[np.uint8]:
        if self._table is None or self._table[0] != style:
            self._table = (style, make_table(style))
        return self._table[1]


def is_same_camera(first: Camera, second: Camera) -> bool:
    """Return True if two cameras have the same pose and intrinsics. Image sizes are not compared."""
    return first is second or (
        np.array_equal(first.intrinsics, second.intrinsics)
        and np.array_equal(first.rotation, second.rotation)
        and np.array_equal(first.translation, second.translation)
    )
