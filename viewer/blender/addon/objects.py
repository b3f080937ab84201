"""The objects of an imported sequence: points, cameras, and an empty object that places them."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from fourd.viewer.blender.addon.look import COLOUR, DENSITY, NODES, RADIUS, point_nodes
from fourd.viewer.blender.addon.points import Cloud, View

SENSOR_MM = 36.0


def new_root(name: str, rotation: NDArray[np.float64], scale: float) -> Any:
    """Add an empty object that rotates and scales its children."""
    root = bpy.data.objects.new(name, None)
    root.empty_display_size = 0.2
    bpy.context.collection.objects.link(root)
    root.matrix_world = Matrix(rotation.tolist()).to_4x4() @ Matrix.Scale(scale, 4)
    return root


def new_points(name: str, root: Any, cloud: Cloud) -> Any:
    """Add an object with the points of a cloud."""
    mesh = bpy.data.meshes.new(name)
    points = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(points)
    points.parent = root
    fill(mesh, cloud)
    modifier = points.modifiers.new(NODES, "NODES")
    modifier.node_group = point_nodes()
    return points


def fill(mesh: Any, cloud: Cloud) -> None:
    """Replace the points of a mesh. The mesh itself is kept, so that its old points are freed."""
    count = len(cloud.xyz)
    mesh.clear_geometry()
    mesh.vertices.add(count)
    mesh.vertices.foreach_set("co", np.ascontiguousarray(cloud.xyz, np.float32).ravel())
    colours = np.ones((count, 4), np.float32)
    colours[:, :3] = linear(cloud.rgb)
    for name, kind, values in (
        (RADIUS, "FLOAT", cloud.radius),
        (DENSITY, "FLOAT", cloud.density),
        (COLOUR, "FLOAT_COLOR", colours),
    ):
        attribute = mesh.attributes.new(name, kind, "POINT")
        key = "color" if kind == "FLOAT_COLOR" else "value"
        attribute.data.foreach_set(key, np.ascontiguousarray(values, np.float32).ravel())
    mesh.update()


def new_camera(view: View, root: Any, collection: Any) -> Any:
    """Add a camera of the capture. Its horizontal focal length and its principal point are kept."""
    data = bpy.data.cameras.new(view.name)
    data.sensor_fit, data.sensor_width = "HORIZONTAL", SENSOR_MM
    data.lens = float(view.intrinsics[0, 0]) * SENSOR_MM / view.width
    data.shift_x = float(view.width / 2 - view.intrinsics[0, 2]) / view.width
    data.shift_y = float(view.intrinsics[1, 2] - view.height / 2) / view.width
    data.clip_start, data.clip_end = 1e-3, 1e4
    camera = bpy.data.objects.new(view.name, data)
    collection.objects.link(camera)
    camera.parent = root
    world = np.eye(4)
    world[:3, :3] = view.rotation.T @ np.diag([1.0, -1.0, -1.0])  # Blender's cameras look along -z, with y up
    world[:3, 3] = view.centre
    camera.matrix_local = Matrix(world.tolist())
    camera["width"], camera["height"] = view.width, view.height
    return camera


def linear(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return linear colours, which Blender's attributes store, of sRGB colours in [0, 1]."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4).astype(np.float32)
