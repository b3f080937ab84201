"""Helpers for viewer tests that draw with OpenGL contexts without a window."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.viewer.display import RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.gl.context import offscreen_context
from fourd.viewer.rendering.renderers import Renderer


def contexts() -> Iterator[moderngl.Context]:
    """Yield a context, and then assert that no GL error has occurred. Skip the test if OpenGL is not available."""
    try:
        context = offscreen_context()
    except UserError as error:
        pytest.skip(f"OpenGL is not available: {error}")
    yield context
    assert context.error == "GL_NO_ERROR"
    context.release()


def require_gl() -> None:
    """Skip the test if OpenGL is not available."""
    try:
        offscreen_context().release()
    except UserError as error:
        pytest.skip(f"OpenGL is not available: {error}")


def render(renderer: Renderer, request: RenderRequest, context: moderngl.Context) -> NDArray[np.float32]:
    """Draw a request and return the image (H, W, 4) float32, with row 0 at the top."""
    canvas = Canvas(context, "f1" if renderer.name == "cpu" else "f4")
    renderer.draw(request, canvas, wait=True)
    image = canvas.read_rgba32f()
    canvas.release()
    return image
