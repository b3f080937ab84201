"""Baked scenes: reading and writing `.4dv` files, and rendering them without torch and without the model."""

from fourd.scene.combine import combine_frames
from fourd.scene.container import SceneReader, SceneWriter
from fourd.scene.rendering import RenderedImage, Scene, open_scene
from fourd.scene.scene import BakedFrame, SceneBackground, SceneManifest
from fourd.scene.shade import shade, shade_reference

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
