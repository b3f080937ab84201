"""Creates OpenGL contexts and queries their drivers."""

from __future__ import annotations

import sys
from typing import Any

import moderngl

from fourd.errors import UserError

REQUIRED_VERSION = 330


def offscreen_context() -> moderngl.Context:
    """An OpenGL context without a window. On Linux, the context uses EGL, which needs no display.

    Raises UserError if OpenGL 3.3 is not available.
    """
    backend = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    try:
        return moderngl.create_context(standalone=True, require=REQUIRED_VERSION, **backend)  # type: ignore[arg-type]
    except Exception as error:
        # The code catches Exception, because moderngl and glcontext raise this class itself and not a subclass.
        raise UserError(
            f"OpenGL: expected version 3.3 or newer, got '{' '.join(str(error).split())}'; "
            "install a driver (Debian: libegl1 libgl1-mesa-dri) or add --renderer cpu"
        ) from error


def driver_info(context: moderngl.Context) -> dict[str, Any]:
    """The names and limits that the driver reports, keyed by the names of the OpenGL constants."""
    info = context.info
    # moderngl also queries limits of newer OpenGL versions. Each query of a limit that the driver does not support sets
    # a GL error, which the loop below clears.
    while context.error != "GL_NO_ERROR":
        pass
    return info


def driver_name(context: moderngl.Context) -> str:
    """The driver's GL_RENDERER string, such as "llvmpipe (LLVM 15.0.6, 256 bits)"."""
    return str(driver_info(context)["GL_RENDERER"])
