"""A context without a window for the tests of this room."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.errors import UserError
from fourd.viewer.display import RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.gl.context import offscreen_context
from fourd.viewer.rendering.renderers import Renderer


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


def drawn(renderer: Renderer, request: RenderRequest, context: moderngl.Context) -> NDArray[np.float32]:
    """The picture (H, W, 4) in floats, row 0 at the top."""
    canvas = Canvas(context, "f1" if renderer.name == "cpu" else "f4")
    renderer.draw(request, canvas, wait=True)
    picture = canvas.read_rgba32f()
    canvas.release()
    return picture
