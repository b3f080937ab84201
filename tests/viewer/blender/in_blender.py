"""Run by a Python that has bpy: imports sequences with the add-on, renders, and prints what it found as JSON.

python in_blender.py FOLDER_OF_THE_ADDON SCENE PLY_FOLDER OUT
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path
from typing import Any

import bpy

FRAMES = (1, 9)


def main(addon: str, scene: str, ply: str, out: Path) -> None:
    sys.path.insert(0, addon)
    import fourd_scenes

    bpy.ops.wm.read_factory_settings(use_empty=True)
    fourd_scenes.register()
    found: dict[str, Any] = {
        "errors": [error_of(path) for path in (out / "nothing.4dv", out / "text.4dv", out / "bad.ply")]
    }
    bpy.ops.import_scene.fourd(filepath=scene)
    current, points = bpy.context.scene, bpy.data.objects[f"{Path(scene).stem} points"]
    found["frames"] = [current.frame_start, current.frame_end, current.render.fps / current.render.fps_base]
    found["cameras"] = [each.name for each in current.objects if each.type == "CAMERA"]
    found["scale"] = list(points.parent.matrix_world.to_scale())
    set_renderer(current)
    for frame in FRAMES:
        current.frame_set(frame)
        current.render.filepath = str(out / f"{frame:02d}.png")
        bpy.ops.render.render(write_still=True)
    found["counts"], found["memory_mb"] = [], []
    for _ in range(4):
        found["counts"] = [count(current, points, frame) for frame in range(1, 17)]
        found["memory_mb"].append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    found["meshes"] = len(bpy.data.meshes)
    bpy.ops.import_scene.fourd(filepath=str(Path(ply) / "000001.ply"), up="Y", use_scene_settings=False, scale=2.0)
    cloud = bpy.data.objects["000001 points"]
    found["ply"] = [count(current, cloud, frame) for frame in (1, 2, 99)]
    found["ply_up"] = list(cloud.parent.matrix_world @ cloud.data.vertices[0].co)
    fourd_scenes.unregister()
    print(json.dumps(found))


def error_of(path: Path) -> str:
    try:
        bpy.ops.import_scene.fourd(filepath=str(path))
    except RuntimeError as error:
        return str(error)
    return ""


def count(scene: Any, points: Any, frame: int) -> int:
    scene.frame_set(frame)
    return len(points.data.vertices)


def set_renderer(scene: Any) -> None:
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 16, False
    scene.world = bpy.data.worlds.new("black")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0, 0, 0, 1)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3], Path(sys.argv[4]))
