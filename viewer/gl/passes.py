"""Render targets, full-screen passes, blend modes and occlusion queries."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType

import moderngl
import numpy as np
from OpenGL import GL

from fourd.viewer.gl.shaders import compile_program, set_uniforms


class RenderTargets:
    """Named textures of one size, and framebuffers that draw into the textures.

    When the size changes, all textures and framebuffers are created again.
    """

    def __init__(self, context: moderngl.Context, formats: dict[str, tuple[int, str]], has_depth: bool = False) -> None:
        """``formats`` maps texture names to (components, dtype). ``has_depth`` adds a depth buffer."""
        self._context = context
        self._formats = formats
        self._has_depth = has_depth
        self._depth_buffer: moderngl.Renderbuffer | None = None
        self._framebuffers: dict[tuple[str, ...], moderngl.Framebuffer] = {}
        self._textures: dict[str, moderngl.Texture] = {}
        self.size = (0, 0)

    def resize(self, size: tuple[int, int]) -> None:
        """Set the size (width, height) of all textures."""
        if size == self.size:
            return
        self.release()
        self.size = size
        for name, (components, dtype) in self._formats.items():
            texture = self._context.texture(size, components, dtype=dtype)
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._textures[name] = texture
        if self._has_depth:
            self._depth_buffer = self._context.depth_renderbuffer(size)

    def texture(self, name: str) -> moderngl.Texture:
        """Return the texture called ``name``."""
        return self._textures[name]

    def clear(self, name: str, first: float = 0.0, second: float = 0.0) -> None:
        """Set the first two components of all texels to ``first`` and ``second``, and the other components to 0."""
        self.framebuffer([name]).clear(color=(first, second, 0.0, 0.0))

    def clear_with_depth(self, name: str) -> None:
        """Fill a texture with 0 and clear the depth buffer."""
        self.framebuffer([name], with_depth=True).clear()

    def framebuffer(self, names: Sequence[str], with_depth: bool = False) -> moderngl.Framebuffer:
        """Return a framebuffer that draws into all textures in ``names`` at once."""
        key = (*names, "depth" if with_depth else "")
        if key not in self._framebuffers:
            buffer = self._depth_buffer if with_depth else None
            self._framebuffers[key] = self._context.framebuffer([self._textures[name] for name in names], buffer)
        return self._framebuffers[key]

    def release(self) -> None:
        """Free all GL objects."""
        for framebuffer in self._framebuffers.values():
            release_framebuffer(self._context, framebuffer)
        for texture in self._textures.values():
            texture.release()
        if self._depth_buffer is not None:
            self._depth_buffer.release()
        self._framebuffers, self._textures, self._depth_buffer, self.size = {}, {}, None, (0, 0)


def release_framebuffer(context: moderngl.Context, framebuffer: moderngl.Framebuffer) -> None:
    """Unbind a framebuffer, then release it.

    If a framebuffer is released while it is bound, moderngl later fails to bind it again.
    """
    if context.fbo is not None and context.fbo.glo == framebuffer.glo:
        context.detect_framebuffer(0).use()
    framebuffer.release()


class FullScreenPass:
    """Runs a fragment shader for every pixel of the bound framebuffer."""

    def __init__(self, context: moderngl.Context, fragment: str) -> None:
        self._program = compile_program(context, "fullscreen.vert.js", fragment)
        self._array = context.vertex_array(self._program, [])

    def run(self, textures: dict[str, moderngl.Texture], **uniforms: object) -> None:
        """Draw with ``textures`` and ``uniforms``, keyed by their names in the shader."""
        for unit, (name, texture) in enumerate(textures.items()):
            texture.use(unit)
            set_uniforms(self._program, **{name: unit})
        set_uniforms(self._program, **uniforms)
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Free all GL objects."""
        self._array.release()
        self._program.release()


class SampleCounter:
    """An occlusion query that counts the samples drawn inside its ``with`` block.

    This class calls OpenGL directly, because the queries of moderngl cannot be deleted.
    """

    def __init__(self) -> None:
        self._query = int(np.asarray(GL.glGenQueries(1)).ravel()[0])

    def __enter__(self) -> SampleCounter:
        GL.glBeginQuery(GL.GL_SAMPLES_PASSED, self._query)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        GL.glEndQuery(GL.GL_SAMPLES_PASSED)

    @property
    def samples(self) -> int:
        """The number of samples that were drawn in the last ``with`` block. Reading this property waits for the GPU."""
        return int(np.asarray(GL.glGetQueryObjectuiv(self._query, GL.GL_QUERY_RESULT)).ravel()[0])

    def release(self) -> None:
        """Delete the query."""
        GL.glDeleteQueries(1, [self._query])


def blend_under(context: moderngl.Context) -> None:
    """Set the blend mode that composites premultiplied colours behind the framebuffer's content."""
    _set_blending(context, moderngl.FUNC_ADD, moderngl.ONE_MINUS_DST_ALPHA, moderngl.ONE)


def blend_over(context: moderngl.Context) -> None:
    """Set the blend mode that composites premultiplied colours over the framebuffer's content."""
    _set_blending(context, moderngl.FUNC_ADD, moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA)


def blend_max(context: moderngl.Context) -> None:
    """Set the blend mode that keeps the maximum of each component."""
    _set_blending(context, moderngl.MAX, moderngl.ONE, moderngl.ONE)


def disable_blending(context: moderngl.Context) -> None:
    """Disable blending and the depth test, so that drawing overwrites the framebuffer's content."""
    context.disable(moderngl.BLEND | moderngl.DEPTH_TEST)


def _set_blending(context: moderngl.Context, equation: int, source: int, destination: int) -> None:
    context.disable(moderngl.DEPTH_TEST)
    context.enable(moderngl.BLEND)
    context.blend_equation = equation  # type: ignore[assignment]  # The equation applies to colour and to alpha.
    context.blend_func = source, destination
