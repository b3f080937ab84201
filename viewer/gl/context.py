"""Contexts, and what their driver is."""

from __future__ import annotations

import sys
from typing import Any

import moderngl

from fourd.errors import UserError

LEAST_VERSION = 330


def offscreen_context() -> moderngl.Context:
    """A context without a window: by EGL on Linux, so that no display is needed.

    Raises UserError where there is none.
    """
    backend = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    try:
        return moderngl.create_context(standalone=True, require=LEAST_VERSION, **backend)  # type: ignore[arg-type]
    except Exception as error:  # moderngl and glcontext raise plain Exceptions
        raise UserError(
            f"OpenGL: expected version 3.3 or newer, got '{' '.join(str(error).split())}'; "
            "install a driver (Debian: libegl1 libgl1-mesa-dri) or add --renderer cpu"
        ) from error


def information(context: moderngl.Context) -> dict[str, Any]:
    """The driver's names and limits, by GL's names for them."""
    found = context.info
    # moderngl asks for those of later versions as well, and each that the driver does not know leaves an error.
    while context.error != "GL_NO_ERROR":
        pass
    return found


def driver_name(context: moderngl.Context) -> str:
    """What the driver calls what it draws with, such as "llvmpipe (LLVM 15.0.6, 256 bits)"."""
    return str(information(context)["GL_RENDERER"])
