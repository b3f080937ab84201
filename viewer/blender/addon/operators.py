"""The entry in the menu File > Import."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from fourd.viewer.blender.addon.frames import PATH, SHOWN, START
from fourd.viewer.blender.addon.objects import new_camera, new_points, new_root
from fourd.viewer.blender.addon.placement import rotation_to_z, up_of
from fourd.viewer.blender.addon.points import ImportProblem
from fourd.viewer.blender.addon.scene_file import read_background
from fourd.viewer.blender.addon.sources import Sequence, open_sequence

TRANSPARENT_BOUNCES = 64
"""Maximum number of points behind each other that Cycles composites per pixel."""
UPS = (
    ("AUTO", "From the cameras", "The mean up direction of the cameras; without cameras, +Z"),
    ("X", "+X", "The file's x axis points up"),
    ("Y", "+Y", "The file's y axis points up"),
    ("Z", "+Z", "The file's z axis points up, so that nothing is turned"),
    ("-Y", "-Y", "The file's y axis points down"),
)


class ImportFourdScene(bpy.types.Operator, ImportHelper):
    """Import a .4dv scene, or the sequence of PLY files to which a file belongs"""

    bl_idname = "import_scene.fourd"
    bl_label = "Import fourd scene"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a set
    filename_ext = ".4dv"

    def execute(self, context: Any) -> set[str]:
        """Import the chosen file. An invalid file is reported in one line."""
        path = Path(bpy.path.abspath(self.filepath))
        try:
            sequence = open_sequence(path)
            first = sequence.read(0)
            background = _background(sequence)
        except ImportProblem as problem:
            self.report({"ERROR"}, str(problem))
            return {"CANCELLED"}
        views = () if sequence.manifest is None else sequence.manifest.views
        up = up_of(self.up, views)
        root = new_root(path.stem, rotation_to_z(up), self.scale * _unit(sequence, self.use_metres))
        points = new_points(f"{path.stem} points", root, first)
        points[PATH], points[START], points[SHOWN] = str(path), self.first_frame, 0
        if background is not None:
            new_points(f"{path.stem} background", root, background)
        cameras = _add_cameras(path.stem, views, root) if self.use_cameras else []
        if self.use_scene_settings:
            _set_up(context.scene, sequence, self.first_frame, cameras)
        context.scene.frame_set(context.scene.frame_current)
        return {"FINISHED"}


# Blender reads properties from the annotations of a class, as values.
ImportFourdScene.__annotations__ = {
    "filter_glob": StringProperty(default="*.4dv;*.ply", options={"HIDDEN"}),
    "first_frame": IntProperty(name="First frame", default=1, description="Frame of Blender at which it starts"),
    "up": EnumProperty(name="Up", items=UPS, default="AUTO", description="Direction that becomes Blender's +Z"),
    "use_metres": BoolProperty(name="Metres", default=True, description="Scale by the scene's metres per unit"),
    "scale": FloatProperty(name="Scale", default=1.0, min=1e-6, description="Further scale"),
    "use_cameras": BoolProperty(name="Cameras", default=True, description="Import the cameras of the capture"),
    "use_scene_settings": BoolProperty(
        name="Set up the scene",
        default=True,
        description="Set frame range, frame rate, image size, camera, and the view transform Standard",
    ),
}


def _background(sequence: Sequence) -> Any:
    manifest = sequence.manifest
    return None if manifest is None or not manifest.background_points else read_background(manifest)


def _unit(sequence: Sequence, use_metres: bool) -> float:
    metres = None if sequence.manifest is None else sequence.manifest.metres_per_unit
    return metres if use_metres and metres is not None else 1.0


def _add_cameras(name: str, views: Any, root: Any) -> list[Any]:
    if not views:
        return []
    collection = bpy.data.collections.new(f"{name} cameras")
    bpy.context.scene.collection.children.link(collection)
    return [new_camera(view, root, collection) for view in views]


def _set_up(scene: Any, sequence: Sequence, first_frame: int, cameras: list[Any]) -> None:
    """Set what an image of the scene needs: the frames, the camera and unchanged colours."""
    scene.frame_start, scene.frame_end = first_frame, first_frame + sequence.frame_count - 1
    scene.frame_current = first_frame
    if sequence.manifest is not None:
        fps = sequence.manifest.fps
        scene.render.fps = max(round(fps), 1)
        scene.render.fps_base = scene.render.fps / fps
    if cameras:
        scene.camera = cameras[0]
        scene.render.resolution_x, scene.render.resolution_y = cameras[0]["width"], cameras[0]["height"]
        scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "Standard"
    scene.render.use_lock_interface = True  # the points change while Blender renders
    if hasattr(scene, "cycles"):
        scene.cycles.transparent_max_bounces = max(scene.cycles.transparent_max_bounces, TRANSPARENT_BOUNCES)


def _draw_menu(menu: Any, _context: Any) -> None:
    menu.layout.operator(ImportFourdScene.bl_idname, text="fourd scene (.4dv, .ply)")


def register() -> None:
    """Add the operator and its entry in the menu."""
    bpy.utils.register_class(ImportFourdScene)
    bpy.types.TOPBAR_MT_file_import.append(_draw_menu)


def unregister() -> None:
    """Remove the operator and its entry in the menu."""
    bpy.types.TOPBAR_MT_file_import.remove(_draw_menu)
    bpy.utils.unregister_class(ImportFourdScene)
