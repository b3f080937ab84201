"""Baked scenes: reading and writing `.4dv` files, and rendering them without torch and without the model.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fourd.scene.combine import combine_frames
    from fourd.scene.container import SceneReader, SceneWriter
    from fourd.scene.rendering import RenderedImage, Scene, open_scene
    from fourd.scene.scene import BakedFrame, SceneBackground, SceneManifest

_MODULES: dict[str, str] = {
    "BakedFrame": "scene",
    "RenderedImage": "rendering",
    "Scene": "rendering",
    "SceneBackground": "scene",
    "SceneManifest": "scene",
    "SceneReader": "container",
    "SceneWriter": "container",
    "combine_frames": "combine",
    "open_scene": "rendering",
}
"""Maps each public name to the module of this package that defines it."""

__all__ = [
    "BakedFrame",
    "RenderedImage",
    "Scene",
    "SceneBackground",
    "SceneManifest",
    "SceneReader",
    "SceneWriter",
    "combine_frames",
    "open_scene",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
