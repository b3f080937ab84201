"""Points projected and coloured once a picture, and the discs that every pass draws of them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.baking.shade import select_source_views
from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.viewer.display import RenderRequest
from fourd.viewer.gl.arrays import UploadedFrame
from fourd.viewer.gl.context import information
from fourd.viewer.gl.shaders import TEXELS_A_ROW, program, set_uniforms

_BYTES_A_DISC = 32
_DISCS_A_ROW = TEXELS_A_ROW // 2
_MOST_RANKS = 1 << 24


class Discs:
    """Discs of the points in sight.

    Nearest first, they are placed in the order in which they are drawn, and know their rank.
    Farthest first, sprites are placed as their points lie in memory and drawn by index: reading
    the points in the order of their depth takes twice the time.
    """

    def __init__(
        self,
        context: moderngl.Context,
        passes: Mapping[str, str],
        farthest_first: bool = False,
        as_texture: bool = False,
    ) -> None:
        """``passes`` maps names to the fragment shaders that :meth:`draw` can draw with.

        With ``as_texture``, :attr:`texture` has the discs as well: two texels each, by rank.
        """
        self._context = context
        self._farthest_first = farthest_first
        self._shade = program(context, "shade.vert", varyings=("disc", "paint"))
        self._programs = {
            (name, shape): program(context, f"{shape}.vert", fragment)
            for name, fragment in passes.items()
            for shape in ("sprite", "square")
        }
        limits = information(context)
        self._largest_sprite: float = limits.get("GL_POINT_SIZE_RANGE", (1.0, 1.0))[1]
        self._largest_viewport: tuple[int, int] = limits["GL_MAX_VIEWPORT_DIMS"]
        self._texture: moderngl.Texture | None = None
        self._as_texture = as_texture
        self._buffers: dict[str, moderngl.Buffer] = {}
        self._shading: dict[str, moderngl.VertexArray] = {}
        self._drawing: dict[tuple[str, str], moderngl.VertexArray] = {}
        self._room = 0
        self._count = 0
        self._size = (1, 1)
        self._margin: int | None = None

    def place(self, uploaded: UploadedFrame, order: NDArray[np.uint32], request: RenderRequest) -> None:
        """Project and shade the points of ``order``, nearest first, as the request's camera sees them."""
        if len(order) >= _MOST_RANKS:
            raise UserError(
                f"OpenGL: expected fewer than {_MOST_RANKS} points in sight, got {len(order)}; add --renderer cpu"
            )
        self._count = len(order)
        self._size = (request.camera.width, request.camera.height)
        self._make_room(max(request.frame.point_count, 1))
        if self._count == 0:
            return
        self._margin = self._sprite_margin(order, request)
        self._buffers["order"].write(np.ascontiguousarray(order[::-1]) if self._farthest_first else order)
        set_uniforms(self._shade, **uploaded.use(), views=request.frame.view_count, **_camera_uniforms(request.camera))
        set_uniforms(self._shade, **_shading_uniforms(request))
        if self._farthest_first and self._margin is not None:
            shading, count = self._shading["sequence"], request.frame.point_count
        else:
            shading, count = self._shading["order"], self._count
        shading.transform(self._buffers["discs"], moderngl.POINTS, vertices=count)
        if self._texture is not None:
            rows = -(-count // _DISCS_A_ROW)
            self._texture.write(self._buffers["discs"], viewport=(0, 0, TEXELS_A_ROW, rows))

    @property
    def texture(self) -> moderngl.Texture:
        """The discs that were placed last."""
        assert self._texture is not None
        return self._texture

    @property
    def as_sprites(self) -> bool:
        """Whether those placed last are drawn as point sprites; else as triangles, with four times the vertices."""
        return self._margin is not None

    def draw(self, name: str, framebuffer: moderngl.Framebuffer, upright: bool = False, **uniforms: object) -> None:
        """Draw every disc with the pass of that name and ``uniforms`` of its shader.

        Row 0 of the picture comes at the framebuffer's top with ``upright``, as it is seen; else at
        its bottom, as textures have it.
        """
        if not self._count:
            return
        shape = "sprite" if self.as_sprites else "square"
        margin = self._margin or 0
        width, height = self._size
        set_uniforms(
            self._programs[name, shape],
            size=self._size,
            upright=upright,
            margin=margin,
            **uniforms,
        )
        framebuffer.use()
        framebuffer.viewport = (-margin, -margin, width + 2 * margin, height + 2 * margin)
        if shape == "square":
            self._drawing[name, shape].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self._count)
        else:
            self._context.enable(moderngl.PROGRAM_POINT_SIZE)
            self._drawing[name, shape].render(moderngl.POINTS, vertices=self._count)
        framebuffer.viewport = (0, 0, width, height)

    def release(self) -> None:
        self._release_buffers()
        for compiled in (self._shade, *self._programs.values()):
            compiled.release()

    def _sprite_margin(self, order: NDArray[np.uint32], request: RenderRequest) -> int | None:
        """How far sprites can reach over an edge, in pixels; None where one may be larger than the driver allows."""
        # The points of a background are large and far: only each at its own depth tells that they are small to see.
        for slope in (_steepest_bound, _steepest):
            margin = math.ceil(float(request.camera.intrinsics[1, 1]) * slope(order, request)) + 1
            if self._sprites_fit(margin):
                return margin
        return None

    def _sprites_fit(self, margin: int) -> bool:
        fits = all(side + 2 * margin <= most for side, most in zip(self._size, self._largest_viewport, strict=True))
        return 2 * margin <= self._largest_sprite and fits

    def _make_room(self, count: int) -> None:
        if count <= self._room:
            return
        self._release_buffers()
        rows = -(-count // _DISCS_A_ROW)
        self._room = rows * _DISCS_A_ROW
        discs = self._context.buffer(reserve=_BYTES_A_DISC * self._room, dynamic=True)
        if self._as_texture:
            self._texture = self._context.texture((TEXELS_A_ROW, rows), 4, dtype="f4")
            self._texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        order = self._context.buffer(reserve=4 * self._room, dynamic=True)
        self._buffers = {"discs": discs, "order": order}
        if self._farthest_first:
            self._buffers["sequence"] = self._context.buffer(np.arange(self._room, dtype=np.uint32))
        self._shading = {
            name: self._context.vertex_array(self._shade, [(self._buffers[name], "1u4", "point")])
            for name in self._buffers
            if name != "discs"
        }
        for (name, shape), compiled in self._programs.items():
            layout = "4f4 4f4" if shape == "sprite" else "4f4 4f4 /i"
            index = order if self._farthest_first and shape == "sprite" else None
            self._drawing[name, shape] = self._context.vertex_array(
                compiled, [(discs, layout, "disc", "paint")], index_buffer=index, index_element_size=4
            )

    def _release_buffers(self) -> None:
        for array in (*self._shading.values(), *self._drawing.values()):
            array.release()
        for buffer in self._buffers.values():
            buffer.release()
        if self._texture is not None:
            self._texture.release()
            self._texture = None
        self._buffers, self._shading, self._drawing = {}, {}, {}
        self._room = 0


def _steepest_bound(order: NDArray[np.uint32], request: RenderRequest) -> float:
    """The largest radius by the depth of the nearest point; at no cost."""
    nearest, camera = request.frame.xyz[order[0]].astype(np.float64), request.camera
    depth = float(nearest @ camera.forward) + float(camera.translation[2])
    return float(request.frame.radius.max()) / max(depth, request.manifest.near)


def _steepest(order: NDArray[np.uint32], request: RenderRequest) -> float:
    """The largest ratio of a point's radius to its depth, beyond the near plane; 140,000 points take a millisecond."""
    camera, near = request.camera, request.manifest.near
    depth = (request.frame.xyz @ camera.forward.astype(np.float32)).take(order) + np.float32(camera.translation[2])
    radius = request.frame.radius.take(order).astype(np.float32)
    # Half of near: the shader's rounding may let pass what is a little nearer.
    ratio = np.where(depth >= near / 2, radius / np.maximum(depth, np.float32(near)), 0)
    return float(ratio.max())


def _camera_uniforms(camera: Camera) -> dict[str, tuple[float, ...]]:
    return {
        "intrinsics_x": tuple(camera.intrinsics[0]),
        "intrinsics_y": tuple(camera.intrinsics[1]),
        "rotation_x": tuple(camera.rotation[0]),
        "rotation_y": tuple(camera.rotation[1]),
        "rotation_z": tuple(camera.rotation[2]),
        "translation": tuple(camera.translation),
        "centre": tuple(camera.centre),
    }


def _shading_uniforms(request: RenderRequest) -> dict[str, object]:
    manifest = request.manifest
    chosen = select_source_views(request.camera, manifest)
    return {
        "chosen": [*chosen, *[0] * (64 - len(chosen))],
        "chosen_count": len(chosen),
        "sh_range": manifest.sh_range,
        "sh_base": manifest.sh_base,
        "near": manifest.near,
    }
