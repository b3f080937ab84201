"""The geometry nodes and the material with which Blender draws points."""

from __future__ import annotations

from typing import Any

import bpy

NODES, MATERIAL = "fourd points", "fourd points"
RADIUS, DENSITY, COLOUR = "radius", "opacity", "colour"
"""Names of the attributes of the points. Cycles keeps the name density for volumes."""


def point_nodes() -> Any:
    """Return the geometry nodes that turn vertices into points with the radii of the attribute ``radius``."""
    found = bpy.data.node_groups.get(NODES)
    if found is not None:
        return found
    tree = bpy.data.node_groups.new(NODES, "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    scale = tree.interface.new_socket("Radius", in_out="INPUT", socket_type="NodeSocketFloat")
    scale.default_value, scale.min_value = 1.0, 0.0
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    start, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    radius = tree.nodes.new("GeometryNodeInputNamedAttribute")
    radius.data_type = "FLOAT"
    radius.inputs["Name"].default_value = RADIUS
    product = tree.nodes.new("ShaderNodeMath")
    product.operation = "MULTIPLY"
    points = tree.nodes.new("GeometryNodeMeshToPoints")
    material = tree.nodes.new("GeometryNodeSetMaterial")
    material.inputs["Material"].default_value = point_material()
    tree.links.new(radius.outputs["Attribute"], product.inputs[0])
    tree.links.new(start.outputs["Radius"], product.inputs[1])
    tree.links.new(start.outputs["Geometry"], points.inputs["Mesh"])
    tree.links.new(product.outputs[0], points.inputs["Radius"])
    tree.links.new(points.outputs["Points"], material.inputs["Geometry"])
    tree.links.new(material.outputs["Geometry"], end.inputs["Geometry"])
    return tree


def point_material() -> Any:
    """Return the material of points: their own colours, without light.

    The alpha is that of fourd, ``density * (1 - d^2 / r^2)`` at the distance d from the centre of a disc of the radius
    r: on a sphere of this radius, the cosine c between the normal and the ray is ``sqrt(1 - d^2 / r^2)``.
    """
    found = bpy.data.materials.get(MATERIAL)
    if found is not None:
        return found
    material = bpy.data.materials.new(MATERIAL)
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    colour, density = tree.nodes.new("ShaderNodeAttribute"), tree.nodes.new("ShaderNodeAttribute")
    colour.attribute_name, density.attribute_name = COLOUR, DENSITY
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    cosine = tree.nodes.new("ShaderNodeVectorMath")
    cosine.operation = "DOT_PRODUCT"
    square, alpha = tree.nodes.new("ShaderNodeMath"), tree.nodes.new("ShaderNodeMath")
    square.operation = alpha.operation = "MULTIPLY"
    emission, clear = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeBsdfTransparent")
    mix, output = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeOutputMaterial")
    for source, target in (
        (geometry.outputs["Normal"], cosine.inputs[0]),
        (geometry.outputs["Incoming"], cosine.inputs[1]),
        (cosine.outputs["Value"], square.inputs[0]),
        (cosine.outputs["Value"], square.inputs[1]),
        (square.outputs[0], alpha.inputs[0]),
        (density.outputs["Fac"], alpha.inputs[1]),
        (colour.outputs["Color"], emission.inputs["Color"]),
        (alpha.outputs[0], mix.inputs["Fac"]),
        (clear.outputs[0], mix.inputs[1]),
        (emission.outputs[0], mix.inputs[2]),
        (mix.outputs[0], output.inputs["Surface"]),
    ):
        tree.links.new(source, target)
    return material
