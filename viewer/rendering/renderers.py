"""The renderer interface, and the choice of a renderer for this machine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.viewer.display import RenderRequest
from fourd.viewer.rendering.cpu import CPURenderer
from fourd.viewer.rendering.renderer_name import RendererName

if TYPE_CHECKING:
    import moderngl

    from fourd.viewer.gl.canvas import Canvas
    from fourd.viewer.gl.frame_textures import Precision

RENDERERS: tuple[RendererName, ...] = get_args(RendererName)

SOFTWARE_DRIVERS = (
    "llvmpipe",
    "softpipe",
    "swrast",
    "swiftshader",
    "software",
    "gdi generic",
    "microsoft basic render",
)
"""A driver renders on the CPU if its GL_RENDERER string, converted to lower case, contains one of these substrings."""


class Renderer(Protocol):
    """Draws requests into canvases."""

    @property
    def name(self) -> str:
        """One of RENDERERS."""

    @property
    def stale_images(self) -> int:
        """Number of successive images, counted back from the last one, that were drawn with the depth order of an
        earlier request.

        The number is 0 if the last image was drawn with its own depth order.
        """

    @property
    def sort_seconds(self) -> float:
        """Duration of the last depth sort in seconds, or 0 for renderers that do not sort."""

    @property
    def style_seconds(self) -> float:
        """Time of the stylizer in seconds for the newest image whose time is known, or 0 if there is no style.

        It does not include the time to draw depths and normals. OpenGL renderers measure it on the GPU.
        """

    @property
    def line_strength(self) -> NDArray[np.uint8]:
        """Strength of the lines that a style has drawn in the last image, as an array (H, W). Raises RuntimeError if
        the image has no style."""

    def draw(self, request: RenderRequest, canvas: Canvas, wait: bool = False) -> None:
        """Draw ``request`` into ``canvas``, at the image size of the request's camera.

        If ``wait`` is True, the image shows the frame of ``request``, drawn in the depth order of ``request``. If
        ``wait`` is False, the frame and the depth order may be those of an earlier request.
        """

    def release(self) -> None:
        """Free all GL objects and stop threads."""


@dataclass(frozen=True)
class RendererChoice:
    """The name of the chosen renderer and the reason for the choice, as shown to the user."""

    name: RendererName
    reason: str


def choose_renderer(requested: RendererName | Literal["auto"], driver: str | None) -> RendererChoice:
    """Choose a renderer.

    Args:
        requested: the renderer that the user has requested, or "auto".
        driver: the driver's GL_RENDERER string, or None if OpenGL is not available.

    Raises:
        UserError: if an OpenGL renderer is requested but OpenGL is not available.
    """
    if requested == "cpu":
        return RendererChoice("cpu", "as requested")
    if requested != "auto":
        if driver is None:
            raise UserError(
                f"--renderer: expected cpu, as OpenGL is not available, got {requested}; add --renderer cpu"
            )
        return RendererChoice(requested, "as requested")
    if driver is None:
        return RendererChoice("cpu", "OpenGL is not available")
    if any(name in driver.lower() for name in SOFTWARE_DRIVERS):
        return RendererChoice("cpu", f"OpenGL runs on the CPU ({driver}); the native kernel is faster")
    return RendererChoice("sorted", f"OpenGL runs on {driver}")


def make_renderer(name: RendererName, context: moderngl.Context | None, precision: Precision = "float16") -> Renderer:
    """Create a renderer. ``precision`` is the floating-point type of arrays and render targets on the GPU.

    Raises ImportError if the native module is not built.
    """
    if name == "cpu" or context is None:
        return CPURenderer()
    from fourd.viewer.gl.compositors import DepthPeeling, DualDepthPeeling, SortedBlending
    from fourd.viewer.gl.depth_order import BackgroundOrders, ExactOrders
    from fourd.viewer.gl.renderer import GLRenderer

    if name == "sorted":
        return GLRenderer(context, name, SortedBlending(context), BackgroundOrders(), precision)
    compositor = DepthPeeling(context, precision) if name == "peel" else DualDepthPeeling(context, precision)
    return GLRenderer(context, name, compositor, ExactOrders(), precision)
