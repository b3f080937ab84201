"""Creates OpenGL contexts and queries their drivers."""

from __future__ import annotations

import sys
from typing import Any

import moderngl

from fourd.base.errors import UserError

REQUIRED_VERSION = 330


def offscreen_context() -> moderngl.Context:
    """Create an OpenGL context without a window. On Linux, the context uses EGL, which needs no display.

    Raises UserError if OpenGL 3.3 is not available.
    """
    backend = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    try:
        return moderngl.create_context(standalone=True, require=REQUIRED_VERSION, **backend)  # type: ignore[arg-type]
    except Exception as error:
        # moderngl and glcontext raise Exception itself, not a subclass.
        raise UserError(
            f"OpenGL: expected version 3.3 or newer, got '{' '.join(str(error).split())}'; "
            "install a driver (Debian: libegl1 libgl1-mesa-dri) or add --renderer cpu"
        ) from error


def driver_info(context: moderngl.Context) -> dict[str, Any]:
    """Return the names and limits that the driver reports, keyed by the names of the OpenGL constants."""
    info = context.info
    # The loop clears the GL errors of this query. They occur because moderngl also queries limits of newer OpenGL
    # versions, which the driver may not support.
    while context.error != "GL_NO_ERROR":
        pass
    return info


def driver_name(context: moderngl.Context) -> str:
    """Return the driver's GL_RENDERER string, such as "llvmpipe (LLVM 15.0.6, 256 bits)"."""
    return str(driver_info(context)["GL_RENDERER"])
