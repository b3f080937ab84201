"""Baked scenes: reading and writing `.4dv` files, and rendering them without torch and without the model.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
    from fourd.scene.combine import combine_frames
    from fourd.scene.container import SceneReader, SceneWriter
    from fourd.scene.rendering import RenderedImage, Scene, open_scene
    from fourd.scene.scene import BakedFrame, SceneBackground, SceneManifest

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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "BakedFrame": "scene",
        "RenderedImage": "rendering",
        "Scene": "rendering",
        "SceneBackground": "scene",
        "SceneManifest": "scene",
        "SceneReader": "container",
        "SceneWriter": "container",
        "combine_frames": "combine",
        "open_scene": "rendering",
    },
)
