"""Projects and shades points once per image, and draws the points as discs in every pass."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, get_args

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.scene.shade import select_source_views
from fourd.viewer.display import RenderRequest
from fourd.viewer.gl.context import driver_info
from fourd.viewer.gl.frame_textures import FrameTextures
from fourd.viewer.gl.image_region import ImageRegion, RegionFinder
from fourd.viewer.gl.shaders import MAX_BLENDED, TEXELS_PER_ROW, compile_program, set_uniforms

Paint = Literal["colour", "normal", "depth"]
"""The quantity that a disc shows: its colour, its normal or its depth. Normals are in camera axes."""

PAINTS: tuple[Paint, ...] = get_args(Paint)
_BYTES_PER_DISC = 32
_DISCS_PER_ROW = TEXELS_PER_ROW // 2
_MAX_RANKS = 1 << 24


class Discs:
    """The discs of the visible points. They are drawn as point sprites, or as quads if sprites may exceed the driver's
    limits.

    Discs are stored in drawing order: nearest first or, if ``farthest_first`` is True, farthest first. Depth peeling
    uses nearest first; there, the rank of a disc (its position in depth order, from 1) is its index plus 1.

    There is one exception: if sprites are drawn farthest first, the discs of all points are stored in the order of the
    frame's points, and an index buffer contains the drawing order. The vertex shader then reads the points in the order
    in which the textures store them, which takes half as long as reading them in depth order.
    """

    def __init__(
        self,
        context: moderngl.Context,
        passes: Mapping[str, str],
        farthest_first: bool = False,
        as_texture: bool = False,
    ) -> None:
        """``passes`` maps the name of each pass to the file of its fragment shader.

        If ``as_texture`` is True, the discs are also stored in :attr:`texture`, in drawing order, with two texels per
        disc.
        """
        self._context = context
        self._farthest_first = farthest_first
        self._shade_program = compile_program(context, "shade.vert", varyings=("disc", "paint"))
        self._draw_programs = {
            (name, shape): compile_program(context, f"{shape}.vert", fragment)
            for name, fragment in passes.items()
            for shape in ("sprite", "quad")
        }
        limits = driver_info(context)
        self._max_sprite_size: float = limits.get("GL_POINT_SIZE_RANGE", (1.0, 1.0))[1]
        self._max_viewport: tuple[int, int] = limits["GL_MAX_VIEWPORT_DIMS"]
        self._texture: moderngl.Texture | None = None
        self._as_texture = as_texture
        self._buffers: dict[str, moderngl.Buffer] = {}
        self._shade_arrays: dict[str, moderngl.VertexArray] = {}
        self._draw_arrays: dict[tuple[str, str], moderngl.VertexArray] = {}
        self._capacity = 0
        self._count = 0
        self._size = (1, 1)
        self._margin: int | None = None
        self._regions = RegionFinder()
        self.region = ImageRegion(0, 0, 1, 1)
        """Part of the image that the projected discs can change, with a margin of one pixel for the filter that is
        applied to the composited image."""

    def project(
        self,
        textures: FrameTextures,
        order: NDArray[np.uint32],
        request: RenderRequest,
        paint: Paint = "colour",
        depth_unit: float = 1.0,
    ) -> None:
        """Project and shade points for the camera of ``request``.

        ``order`` contains the indices of the points, nearest first. Normals can be drawn only if the frame has normals.
        Depths are in multiples of ``depth_unit``, which is in world units. Raises UserError if 2^24 or more points are
        visible.
        """
        if len(order) >= _MAX_RANKS:
            raise UserError(
                f"OpenGL: expected fewer than {_MAX_RANKS} visible points, got {len(order)}; add --renderer cpu"
            )
        self._count = len(order)
        self._size = (request.camera.width, request.camera.height)
        self._reserve(max(request.frame.point_count, 1))
        if self._count == 0:
            self.region = ImageRegion(0, 0, 0, 0)
            return
        self._margin = self._sprite_margin(order, request)
        self.region = self._regions.find(request, self._margin)
        self._buffers["order"].write(np.ascontiguousarray(order[::-1]) if self._farthest_first else order)
        views = request.frame.view_count
        set_uniforms(self._shade_program, **textures.use(), views=views, **_camera_uniforms(request.camera))
        set_uniforms(self._shade_program, painted=PAINTS.index(paint), depth_unit=depth_unit)
        set_uniforms(self._shade_program, **_shading_uniforms(request))
        if self._farthest_first and self._margin is not None:
            array, count = self._shade_arrays["sequence"], request.frame.point_count
        else:
            array, count = self._shade_arrays["order"], self._count
        array.transform(self._buffers["discs"], moderngl.POINTS, vertices=count)
        if self._texture is not None:
            rows = -(-count // _DISCS_PER_ROW)
            self._texture.write(self._buffers["discs"], viewport=(0, 0, TEXELS_PER_ROW, rows))

    @property
    def texture(self) -> moderngl.Texture:
        """The discs that the last call of :meth:`project` stored."""
        assert self._texture is not None
        return self._texture

    @property
    def uses_sprites(self) -> bool:
        """Whether the discs are drawn as point sprites and not as quads.

        Quads need four times as many vertices as sprites.
        """
        return self._margin is not None

    def draw(self, name: str, framebuffer: moderngl.Framebuffer, upright: bool = False, **uniforms: object) -> None:
        """Draw all discs with pass ``name`` and the ``uniforms`` of its shader.

        If ``upright`` is True, row 0 of the image is at the top of the framebuffer, as on screen. If ``upright`` is
        False, row 0 of the image is at the bottom, as in textures.
        """
        if not self._count:
            return
        shape = "sprite" if self.uses_sprites else "quad"
        margin = self._margin or 0
        width, height = self._size
        set_uniforms(
            self._draw_programs[name, shape],
            size=self._size,
            upright=upright,
            margin=margin,
            **uniforms,
        )
        framebuffer.use()
        framebuffer.viewport = (-margin, -margin, width + 2 * margin, height + 2 * margin)
        if shape == "quad":
            self._draw_arrays[name, shape].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self._count)
        else:
            self._context.enable(moderngl.PROGRAM_POINT_SIZE)
            self._draw_arrays[name, shape].render(moderngl.POINTS, vertices=self._count)
        framebuffer.viewport = (0, 0, width, height)

    def release(self) -> None:
        """Free all GL objects."""
        self._release_buffers()
        for program in (self._shade_program, *self._draw_programs.values()):
            program.release()

    def _sprite_margin(self, order: NDArray[np.uint32], request: RenderRequest) -> int | None:
        """Return the number of pixels by which sprites can extend past the image, or None if sprites may exceed the
        driver's limits."""
        # The first bound of radius / depth is fast to compute. It is too large for scenes with a background, whose
        # points have large radii but are far away, so the exact ratio is tried next.
        for ratio in (_radius_depth_ratio_bound, _max_radius_depth_ratio):
            margin = math.ceil(float(request.camera.intrinsics[1, 1]) * ratio(order, request)) + 1
            if self._driver_allows(margin):
                return margin
        return None

    def _driver_allows(self, margin: int) -> bool:
        sides = zip(self._size, self._max_viewport, strict=True)
        return 2 * margin <= self._max_sprite_size and all(side + 2 * margin <= limit for side, limit in sides)

    def _reserve(self, count: int) -> None:
        if count <= self._capacity:
            return
        self._release_buffers()
        rows = -(-count // _DISCS_PER_ROW)
        self._capacity = rows * _DISCS_PER_ROW
        discs = self._context.buffer(reserve=_BYTES_PER_DISC * self._capacity, dynamic=True)
        if self._as_texture:
            self._texture = self._context.texture((TEXELS_PER_ROW, rows), 4, dtype="f4")
            self._texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        order = self._context.buffer(reserve=4 * self._capacity, dynamic=True)
        self._buffers = {"discs": discs, "order": order}
        if self._farthest_first:
            self._buffers["sequence"] = self._context.buffer(np.arange(self._capacity, dtype=np.uint32))
        self._shade_arrays = {
            name: self._context.vertex_array(self._shade_program, [(self._buffers[name], "1u4", "point")])
            for name in self._buffers
            if name != "discs"
        }
        for (name, shape), program in self._draw_programs.items():
            layout = "4f4 4f4" if shape == "sprite" else "4f4 4f4 /i"
            index = order if self._farthest_first and shape == "sprite" else None
            self._draw_arrays[name, shape] = self._context.vertex_array(
                program, [(discs, layout, "disc", "paint")], index_buffer=index, index_element_size=4
            )

    def _release_buffers(self) -> None:
        for array in (*self._shade_arrays.values(), *self._draw_arrays.values()):
            array.release()
        for buffer in self._buffers.values():
            buffer.release()
        if self._texture is not None:
            self._texture.release()
            self._texture = None
        self._buffers, self._shade_arrays, self._draw_arrays = {}, {}, {}
        self._capacity = 0


def _radius_depth_ratio_bound(order: NDArray[np.uint32], request: RenderRequest) -> float:
    """Return the largest radius divided by the smallest depth, a cheap upper bound of
    :func:`_max_radius_depth_ratio`."""
    nearest, camera = request.frame.xyz[order[0]].astype(np.float64), request.camera
    depth = float(nearest @ camera.forward) + float(camera.translation[2])
    return float(request.frame.radius.max()) / max(depth, request.manifest.near)


def _max_radius_depth_ratio(order: NDArray[np.uint32], request: RenderRequest) -> float:
    """Return the largest ratio of radius to depth among the points beyond the near plane.

    The computation takes 1 ms for 140,000 points.
    """
    camera, near = request.camera, request.manifest.near
    depth = (request.frame.xyz @ camera.forward.astype(np.float32)).take(order) + np.float32(camera.translation[2])
    radius = request.frame.radius.take(order).astype(np.float32)
    # The minimum depth is near / 2 instead of near, because rounding in the shader can accept points slightly in front
    # of the near plane.
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
        "camera_centre": tuple(camera.centre),
    }


def _shading_uniforms(request: RenderRequest) -> dict[str, object]:
    manifest = request.manifest
    blended = select_source_views(request.camera, manifest)
    unused = MAX_BLENDED - len(blended.indices)
    return {
        "blended_views": [*blended.indices, *[0] * unused],
        "view_weights": [*map(float, blended.weights), *[0.0] * unused],
        "blended_count": len(blended.indices),
        "sh_range": manifest.sh_range,
        "sh_base": manifest.sh_base,
        "near": manifest.near,
    }
