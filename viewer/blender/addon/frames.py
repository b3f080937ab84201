"""Shows the points of the current frame whenever the frame changes, also while Blender renders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

from fourd.viewer.blender.addon.objects import fill
from fourd.viewer.blender.addon.points import ImportProblem
from fourd.viewer.blender.addon.sources import open_sequence

PATH, START, SHOWN, PROBLEM = "fourd_path", "fourd_first_frame", "fourd_shown", "fourd_problem"
"""Properties of an object with points: its file, the frame of Blender at which it starts, the index of the shown frame,
and the last error."""


def register() -> None:
    """Start following the frame."""
    if follow not in bpy.app.handlers.frame_change_pre:
        bpy.app.handlers.frame_change_pre.append(follow)


def unregister() -> None:
    """Stop following the frame."""
    if follow in bpy.app.handlers.frame_change_pre:
        bpy.app.handlers.frame_change_pre.remove(follow)


@persistent
def follow(scene: Any, _graph: Any = None) -> None:
    """Show the current frame of all sequences of the scene."""
    for points in scene.objects:
        if PATH in points and points.type == "MESH" and not points.data.is_editmode:
            show(points, scene.frame_current)


def show(points: Any, frame: int) -> None:
    """Fill an object with the points that its sequence has at a frame of Blender. Before its first and after its last
    frame, the sequence stands still. If the file cannot be read, the object keeps its points, and the error is printed
    once."""
    try:
        sequence = open_sequence(Path(bpy.path.abspath(points[PATH])))
        index = min(max(frame - points[START], 0), sequence.frame_count - 1)
        if points.get(SHOWN) == index:
            return
        fill(points.data, sequence.read(index))
        points[SHOWN] = index
        points[PROBLEM] = ""
    except ImportProblem as problem:
        if points.get(PROBLEM) != str(problem):
            print(f"fourd scenes: {problem}")
            points[PROBLEM] = str(problem)
