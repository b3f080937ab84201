"""Renderers behind one small interface, and which of them suits the machine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, get_args

from fourd.errors import UserError
from fourd.viewer.display import RenderRequest
from fourd.viewer.rendering.cpu import CPURenderer

if TYPE_CHECKING:
    import moderngl

    from fourd.viewer.gl.arrays import Precision
    from fourd.viewer.gl.canvas import Canvas

RendererName = Literal["sorted", "peel", "dual", "cpu"]
RENDERERS: tuple[RendererName, ...] = get_args(RendererName)

SOFTWARE = ("llvmpipe", "softpipe", "swrast", "swiftshader", "software", "gdi generic", "microsoft basic render")
"""What drivers that draw on the CPU call themselves."""


class Renderer(Protocol):
    """Draws shots on canvases."""

    @property
    def name(self) -> str:
        """One of RENDERERS."""

    @property
    def behind(self) -> int:
        """How many pictures in a row were drawn with an order of points older than the request; 0 when exact."""

    @property
    def sort_seconds(self) -> float:
        """What sorting took last; 0 for renderers that do not sort."""

    def draw(self, request: RenderRequest, canvas: Canvas, wait: bool = False) -> None:
        """Draw the request on ``canvas``, in its camera's size.

        Nothing is drawn from the past with ``wait``; without it, the order of points may be a little older.
        """

    def release(self) -> None:
        """Give back every GL object, and stop threads."""


@dataclass(frozen=True)
class RendererChoice:
    """A renderer's name, and why it was taken, in words for the user."""

    name: RendererName
    reason: str


def choose_renderer(wanted: RendererName | Literal["auto"], driver: str | None) -> RendererChoice:
    """Which renderer to take.

    Args:
        wanted: by the user.
        driver: what GL calls its renderer; None where there is no GL.

    Raises:
        UserError: when a GL renderer is wanted and there is no GL.
    """
    if wanted == "cpu":
        return RendererChoice("cpu", "as asked")
    if wanted != "auto":
        if driver is None:
            raise UserError(f"--renderer: expected cpu, as there is no OpenGL here, got {wanted}; add --renderer cpu")
        return RendererChoice(wanted, "as asked")
    if driver is None:
        return RendererChoice("cpu", "there is no OpenGL here")
    if any(name in driver.lower() for name in SOFTWARE):
        return RendererChoice("cpu", f"OpenGL is drawn by the CPU here ({driver}), where our own kernel is faster")
    return RendererChoice("sorted", f"OpenGL is drawn by {driver}")


def make_renderer(name: RendererName, context: moderngl.Context | None, precision: Precision = "float16") -> Renderer:
    """A renderer by name; ``precision`` is that of arrays and pictures in GL.

    Raises ImportError where the native module is not built.
    """
    if name == "cpu" or context is None:
        return CPURenderer()
    from fourd.viewer.gl.depth_order import BackgroundOrders, ExactOrders
    from fourd.viewer.gl.renderer import GLRenderer
    from fourd.viewer.gl.techniques import Dual, Peel, Sorted

    if name == "sorted":
        return GLRenderer(context, name, Sorted(context), BackgroundOrders(), precision)
    technique = Peel(context, precision) if name == "peel" else Dual(context, precision)
    return GLRenderer(context, name, technique, ExactOrders(), precision)
