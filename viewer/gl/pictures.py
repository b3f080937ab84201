"""Textures that pictures are composited in, and passes over every pixel of one."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType

import moderngl
import numpy as np
from OpenGL import GL

from fourd.viewer.gl.shaders import program, set_uniforms


class Pictures:
    """Textures of one size by name, with a framebuffer of each; made anew when the size changes."""

    def __init__(self, context: moderngl.Context, formats: dict[str, tuple[int, str]], depth: bool = False) -> None:
        """``formats`` maps names to components and dtype; ``depth`` adds a depth buffer to :meth:`together`."""
        self._context = context
        self._formats = formats
        self._depth = depth
        self._depth_buffer: moderngl.Renderbuffer | None = None
        self._framebuffers: dict[tuple[str, ...], moderngl.Framebuffer] = {}
        self._textures: dict[str, moderngl.Texture] = {}
        self.size = (0, 0)

    def resize(self, size: tuple[int, int]) -> None:
        """Give every texture ``size`` (width, height)."""
        if size == self.size:
            return
        self.release()
        self.size = size
        for name, (components, dtype) in self._formats.items():
            texture = self._context.texture(size, components, dtype=dtype)
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._textures[name] = texture
        if self._depth:
            self._depth_buffer = self._context.depth_renderbuffer(size)

    def texture(self, name: str) -> moderngl.Texture:
        return self._textures[name]

    def clear(self, name: str, first: float = 0.0, second: float = 0.0) -> None:
        """Fill one texture: its first two components as told, the others with 0."""
        self.together([name], depth=False).clear(color=(first, second, 0.0, 0.0))

    def clear_depth(self, name: str) -> None:
        """Clear the depth buffer together with one texture, to 0."""
        self.together([name], depth=True).clear()

    def together(self, names: Sequence[str], depth: bool) -> moderngl.Framebuffer:
        """A framebuffer that draws into these textures at once, with or without the depth buffer."""
        key = (*names, "with depth" if depth else "")
        if key not in self._framebuffers:
            buffer = self._depth_buffer if depth else None
            self._framebuffers[key] = self._context.framebuffer([self._textures[name] for name in names], buffer)
        return self._framebuffers[key]

    def release(self) -> None:
        for framebuffer in self._framebuffers.values():
            release_framebuffer(self._context, framebuffer)
        for texture in self._textures.values():
            texture.release()
        if self._depth_buffer is not None:
            self._depth_buffer.release()
        self._framebuffers, self._textures, self._depth_buffer, self.size = {}, {}, None, (0, 0)


def release_framebuffer(context: moderngl.Context, framebuffer: moderngl.Framebuffer) -> None:
    """Release a framebuffer, which is no longer in use then: moderngl would come back to it, an error by then."""
    if context.fbo is not None and context.fbo.glo == framebuffer.glo:
        context.detect_framebuffer(0).use()
    framebuffer.release()


class FullPass:
    """A fragment shader run for every pixel of the framebuffer in use."""

    def __init__(self, context: moderngl.Context, fragment: str) -> None:
        self._program = program(context, "full.vert", fragment)
        self._array = context.vertex_array(self._program, [])

    def run(self, textures: dict[str, moderngl.Texture], **uniforms: object) -> None:
        """``textures`` and ``uniforms`` by their names in the shader."""
        for unit, (name, texture) in enumerate(textures.items()):
            texture.use(unit)
            set_uniforms(self._program, **{name: unit})
        set_uniforms(self._program, **uniforms)
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        self._array.release()
        self._program.release()


class PixelCount:
    """Counts the pixels that pass; moderngl's own queries cannot be deleted."""

    def __init__(self) -> None:
        self._name = int(np.asarray(GL.glGenQueries(1)).ravel()[0])

    def __enter__(self) -> PixelCount:
        GL.glBeginQuery(GL.GL_SAMPLES_PASSED, self._name)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        GL.glEndQuery(GL.GL_SAMPLES_PASSED)

    @property
    def pixels(self) -> int:
        """Of the block that ended last; waits for it."""
        return int(np.asarray(GL.glGetQueryObjectuiv(self._name, GL.GL_QUERY_RESULT)).ravel()[0])

    def release(self) -> None:
        GL.glDeleteQueries(1, [self._name])


def under(context: moderngl.Context) -> None:
    """Blend premultiplied colours under those that are there."""
    _blend(context, moderngl.FUNC_ADD, moderngl.ONE_MINUS_DST_ALPHA, moderngl.ONE)


def over(context: moderngl.Context) -> None:
    """Blend premultiplied colours over those that are there."""
    _blend(context, moderngl.FUNC_ADD, moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA)


def largest(context: moderngl.Context) -> None:
    """Keep the larger of each number."""
    _blend(context, moderngl.MAX, moderngl.ONE, moderngl.ONE)


def replace(context: moderngl.Context) -> None:
    """Blend nothing."""
    context.disable(moderngl.BLEND | moderngl.DEPTH_TEST)


def _blend(context: moderngl.Context, equation: int, source: int, destination: int) -> None:
    context.disable(moderngl.DEPTH_TEST)
    context.enable(moderngl.BLEND)
    context.blend_equation = equation  # type: ignore[assignment]  # one for colour and alpha
    context.blend_func = source, destination
