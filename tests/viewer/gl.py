"""A context without a window for the tests of this room."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.errors import UserError
from fourd.viewer.gl.context import offscreen_context
from fourd.viewer.gl.pictures import release_framebuffer
from fourd.viewer.look import Shot
from fourd.viewer.renderers import Renderer


def contexts() -> Iterator[moderngl.Context]:
    """One context; skips where there is none. It must have no error at the end."""
    try:
        context = offscreen_context()
    except UserError as error:
        pytest.skip(f"no OpenGL here: {error}")
    yield context
    assert context.error == "GL_NO_ERROR"
    context.release()


def require_gl() -> None:
    """Skips where there is no context to be had."""
    try:
        offscreen_context().release()
    except UserError as error:
        pytest.skip(f"no OpenGL here: {error}")


def drawn(renderer: Renderer, shot: Shot, context: moderngl.Context) -> NDArray[np.float32]:
    """The picture (H, W, 4) in floats, row 0 at the top."""
    size = (shot.camera.width, shot.camera.height)
    texture = context.texture(size, 4, dtype="f4")
    framebuffer = context.framebuffer([texture])
    renderer.draw(shot, framebuffer, wait=True)
    content = np.frombuffer(framebuffer.read(components=4, dtype="f4"), np.float32)
    release_framebuffer(context, framebuffer)
    texture.release()
    return content.reshape(size[1], size[0], 4)[::-1]
