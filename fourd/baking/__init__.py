"""Baked scenes: reading and writing `.4dv` files, and rendering them without torch and without the model."""

from fourd.baking.combine import combine_frames
from fourd.baking.container import SceneReader, SceneWriter
from fourd.baking.rendering import RenderedImage, Scene, open_scene
from fourd.baking.scene import BakedFrame, SceneBackground, SceneManifest
from fourd.baking.shade import shade, shade_reference

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
    "shade",
    "shade_reference",
]
