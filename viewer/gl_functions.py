"""OpenGL functions that moderngl does not offer: queries that can be deleted, and copies of a part of a framebuffer.

They are loaded from the system's OpenGL library and work with the current context. The package PyOpenGL has these
functions too, but then rendering without a window would need a package that only windows need otherwise.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Sequence
from ctypes.util import find_library
from functools import cache
from typing import Any

from fourd.base.errors import UserError

TEXTURE_2D = 0x0DE1
SAMPLES_PASSED = 0x8914
TIME_ELAPSED = 0x88BF
QUERY_RESULT = 0x8866
QUERY_RESULT_AVAILABLE = 0x8867

_ENUM, _NAME, _INT, _SIZE, _NAMES = (
    ctypes.c_uint,
    ctypes.c_uint,
    ctypes.c_int,
    ctypes.c_int,
    ctypes.POINTER(ctypes.c_uint),
)
_SIGNATURES: dict[str, tuple[Any, ...]] = {
    "glCopyTexSubImage2D": (_ENUM, _INT, _INT, _INT, _INT, _INT, _SIZE, _SIZE),
    "glGenQueries": (_SIZE, _NAMES),
    "glDeleteQueries": (_SIZE, _NAMES),
    "glBeginQuery": (_ENUM, _NAME),
    "glEndQuery": (_ENUM,),
    "glGetQueryObjectuiv": (_NAME, _ENUM, _NAMES),
}


def copy_to_texture(x: int, y: int, width: int, height: int) -> None:
    """Copy a rectangle of the framebuffer to the same place of the texture that is bound to the active unit."""
    _function("glCopyTexSubImage2D")(TEXTURE_2D, 0, x, y, x, y, width, height)


def make_queries(count: int) -> list[int]:
    """Return the names of new queries."""
    names = (ctypes.c_uint * count)()
    _function("glGenQueries")(count, names)
    return list(names)


def delete_queries(queries: Sequence[int]) -> None:
    """Delete queries."""
    _function("glDeleteQueries")(len(queries), (ctypes.c_uint * len(queries))(*queries))


def begin_query(target: int, query: int) -> None:
    """Start a query of the kind ``target``."""
    _function("glBeginQuery")(target, query)


def end_query(target: int) -> None:
    """End the active query of the kind ``target``."""
    _function("glEndQuery")(target)


def query_value(query: int, value: int) -> int:
    """Return a value of a query: ``QUERY_RESULT``, which waits for the GPU, or ``QUERY_RESULT_AVAILABLE``.

    Results have 32 bits. This is enough for times of up to 4 s in nanoseconds.
    """
    result = ctypes.c_uint()
    _function("glGetQueryObjectuiv")(query, value, ctypes.byref(result))
    return result.value


@cache
def _function(name: str) -> Callable[..., None]:
    library = _library()
    if sys.platform == "win32":
        # opengl32.dll exports only the functions of OpenGL 1.1. The driver has the others.
        library.wglGetProcAddress.restype = ctypes.c_void_p
        address = library.wglGetProcAddress(name.encode())
        if address:
            return ctypes.WINFUNCTYPE(None, *_SIGNATURES[name])(address)
    function = getattr(library, name)
    function.restype, function.argtypes = None, _SIGNATURES[name]
    return function


@cache
def _library() -> Any:
    """Load the system's OpenGL library. moderngl has loaded the same library for the current context."""
    if sys.platform == "win32":
        return ctypes.WinDLL("opengl32")
    if sys.platform == "darwin":
        return ctypes.CDLL("/System/Library/Frameworks/OpenGL.framework/OpenGL")
    for name in (find_library("GL"), find_library("OpenGL"), "libGL.so.1", "libOpenGL.so.0"):
        try:
            if name is not None:
                return ctypes.CDLL(name)
        except OSError:
            continue
    raise UserError("OpenGL: expected the library libGL, got none; install it (Debian: libgl1) or add --renderer cpu")
