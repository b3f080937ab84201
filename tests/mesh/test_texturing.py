"""Texture atlases and colours from views, compared with a sphere whose colours are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at
from fourd.reconstruction.meshes.rendering import render_mesh, silhouette_iou
from fourd.reconstruction.meshes.texturing.atlas import build_atlas, find_texels
from fourd.reconstruction.meshes.texturing.blending import blend_views
from fourd.reconstruction.meshes.texturing.inpainting import GREY, fill_between_charts, fill_vertices
from fourd.reconstruction.meshes.texturing.texture import TexturedMesh, colour_mesh, texture_mesh
from fourd.reconstruction.meshes.texturing.visibility import Occluder
from fourd.reconstruction.meshes.views import MeshView, depth_image, mesh_views
from tests.captures import ring_cameras

Z = np.array([0.0, 0.0, 1.0])
SPHERE = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
XYZ = np.asarray(SPHERE.vertices, np.float32)
FACES = np.asarray(SPHERE.faces, np.int64)


def colours(xyz: NDArray[np.floating]) -> NDArray[np.float32]:
    """Smooth colours of points (N, 3) on the sphere."""
    return (0.5 + 0.7 * xyz[:, [0, 2, 1]]).astype(np.float32)


def exact_view(camera: Camera) -> MeshView:
    """Image and matte of the sphere, by intersecting rays."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3)
    rays = pixels @ np.linalg.inv(camera.intrinsics).T @ camera.rotation
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    along = rays @ camera.centre
    root = along**2 - (camera.centre @ camera.centre - 0.25)
    hit = root > 0
    xyz = camera.centre + (-along - np.sqrt(np.maximum(root, 0)))[:, None] * rays
    shape = camera.height, camera.width
    rgb = np.where(hit[:, None], colours(xyz), 1).reshape(*shape, 3)
    return MeshView(camera, rgb.astype(np.float32), hit.reshape(shape).astype(np.float32))


@pytest.fixture(scope="module")
def views() -> list[MeshView]:
    return [exact_view(camera) for camera in ring_cameras(8, 96)]


@pytest.fixture(scope="module")
def textured(views: list[MeshView]) -> TexturedMesh:
    return texture_mesh(XYZ, FACES, views, 256)


def test_charts_do_not_overlap_and_cover_all_triangles() -> None:
    """Catches an atlas with flipped texture coordinates, overlapping charts, or triangles in the wrong order."""
    atlas = build_atlas(XYZ, FACES, 256)
    np.testing.assert_array_equal(atlas.source[atlas.triangles], FACES)
    assert atlas.uv.min() >= 0
    assert atlas.uv.max() <= 1
    texels = find_texels(atlas, 256)
    found = texels.interpolate(XYZ, atlas.source[atlas.triangles])
    uv = texels.interpolate(atlas.uv, atlas.triangles)
    rows, columns = np.nonzero(texels.covered)
    np.testing.assert_allclose(uv, np.stack([columns + 0.5, rows + 0.5], axis=1) / 256, atol=1e-5)
    assert np.abs(np.linalg.norm(found, axis=1) - 0.5).max() < 5e-3
    a, b, c = (atlas.uv[atlas.triangles[:, corner]].astype(np.float64) for corner in range(3))
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2
    assert texels.covered.mean() == pytest.approx(area, rel=0.03)


def test_texels_have_the_colours_of_the_surface(textured: TexturedMesh) -> None:
    """Catches wrong projections, transposed textures and swapped channels. The poles, which no camera sees, are
    filled."""
    size = len(textured.texture)
    x, y = (textured.uv * size).astype(int).clip(0, size - 1).T
    error = np.abs(textured.texture[y, x] / 255 - colours(textured.xyz))
    assert np.median(error) < 0.01
    assert error.max() < 0.15


def test_unseen_views_look_like_the_sphere(textured: TexturedMesh) -> None:
    """Catches seams between charts, background colours at the contour, and a shifted rendering."""
    intrinsics = np.array([[100.0, 0, 48], [0, 100.0, 48], [0, 0, 1]])
    view = exact_view(look_at(np.array([1.4, 1.3, 0.4]), np.zeros(3), Z, intrinsics, 96, 96))
    rendered = render_mesh(textured, view.camera)
    assert silhouette_iou(rendered.alpha, (view.matte * 255).astype(np.uint8)) > 0.97
    inside = rendered.alpha > 0.999
    assert np.abs(rendered.rgb - view.rgb)[inside].max() < 0.08


def test_vertex_colours_match_the_surface(views: list[MeshView]) -> None:
    """Catches normals that face inwards. No view would then see a vertex."""
    normals, rgb = colour_mesh(XYZ, FACES, views)
    np.testing.assert_allclose(normals, XYZ / 0.5, atol=0.02)
    assert np.abs(rgb / 255 - colours(XYZ)).max() < 0.15


def test_hidden_parts_get_no_colours_of_the_part_in_front(views: list[MeshView]) -> None:
    """Catches a missing occlusion test. Without the test, the far ball gets colours of the near ball."""
    near = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    near.apply_translation([1.2, 0, 0])
    both = trimesh.util.concatenate([SPHERE, near])
    camera = look_at(np.array([3.0, 0, 0]), np.zeros(3), Z, np.array([[90.0, 0, 48], [0, 90.0, 48], [0, 0, 1]]), 96, 96)
    xyz, faces = np.asarray(both.vertices, np.float32), np.asarray(both.faces, np.int64)
    depth = depth_image(torch.from_numpy(xyz), torch.from_numpy(faces), camera)
    assert depth[48, 48] == pytest.approx(1.6, abs=0.01)
    image = np.zeros((96, 96, 3), np.float32)
    image[np.isfinite(depth)] = (0, 1, 0)
    image[depth < 2] = (1, 0, 0)
    view = MeshView(camera, image, np.isfinite(depth).astype(np.float32))
    _, rgb = colour_mesh(xyz, faces, [view])
    ball = rgb[: len(XYZ)]
    assert ball[:, 0].max() < 100
    assert (ball[:, 1] > 200).sum() > 300


def test_a_part_close_behind_another_is_hidden() -> None:
    """Catches a tolerance in pixels. A part that is one pixel behind another would then get the colours of the part in
    front.
    """
    intrinsics = np.array([[90.0, 0, 48], [0, 90.0, 48], [0, 0, 1]])
    camera = look_at(np.array([0.0, -3.0, 0]), np.zeros(3), Z, intrinsics, 96, 96)
    front, back = (trimesh.creation.box((0.4, 0.01, 0.4)).subdivide().subdivide() for _ in range(2))
    back.apply_translation([0.2, 0.04, 0])
    both = trimesh.util.concatenate([front, back])
    xyz, faces = np.asarray(both.vertices, np.float32), np.asarray(both.faces, np.int64)
    normals = np.tile(np.float32([0, -1, 0]), (len(xyz), 1))
    view = MeshView(camera, np.ones((96, 96, 3), np.float32), np.ones((96, 96), np.float32))
    _, weight = blend_views(xyz, normals, [view], Occluder.of(xyz, faces))
    behind = np.abs(xyz[:, 1] - 0.035) < 1e-3
    hidden, shown = behind & (xyz[:, 0] < 0.19), behind & (xyz[:, 0] > 0.25)
    assert hidden.sum() >= 10
    assert not weight[hidden].any()
    assert weight[shown].all()


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_visibility_does_not_depend_on_the_unit(scale: float, views: list[MeshView]) -> None:
    """Catches distances in metres: a mesh in millimetres or kilometres must get the same colours."""
    scaled = []
    for view in views:
        camera = view.camera
        moved = replace(camera, translation=camera.translation * scale)
        scaled.append(MeshView(moved, view.rgb, view.matte))
    _, expected = colour_mesh(XYZ, FACES, views)
    _, found = colour_mesh(XYZ * np.float32(scale), FACES, scaled)
    assert np.abs(found.astype(int) - expected.astype(int)).max() <= 1


def test_harmonic_fill_spreads_colours_over_the_surface() -> None:
    """Catches colours that jump to unconnected parts, changed known colours, and a singular system."""
    faces = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4], [5, 6, 7]])
    rgb = np.zeros((8, 3), np.float32)
    rgb[4] = 1
    known = np.array([True, False, False, False, True, False, False, False])
    filled = fill_vertices(rgb, known, faces)
    np.testing.assert_array_equal(filled[[0, 4]], rgb[[0, 4]])
    # Vertices 1, 2 and 3 are the means of their neighbours.
    np.testing.assert_allclose(filled[1:4, 0], [3 / 8, 1 / 2, 5 / 8], atol=1e-4)
    np.testing.assert_allclose(filled[5:], GREY, atol=1e-6)


def test_texels_between_charts_copy_the_nearest_chart() -> None:
    """Catches black borders around charts."""
    texture, covered = np.zeros((4, 6, 3), np.float32), np.zeros((4, 6), np.bool_)
    texture[:, 0], texture[:, 5] = 0.25, 0.75
    covered[:, [0, 5]] = True
    filled = fill_between_charts(texture, covered)
    np.testing.assert_array_equal(filled[2, :, 0], [0.25, 0.25, 0.25, 0.75, 0.75, 0.75])


def test_crops_keep_the_projection() -> None:
    """Catches a crop whose camera is shifted."""
    camera = ring_cameras(1, 96)[0]
    view = exact_view(camera)
    image, matte = ((value * 255).astype(np.uint8) for value in (view.rgb, view.matte))
    cropped = mesh_views([image], [matte], [camera])[0]
    pixels, _ = camera.project(XYZ[:1])
    moved, _ = cropped.camera.project(XYZ[:1])
    left, top = (pixels - moved)[0].round().astype(int)
    height, width = cropped.matte.shape
    np.testing.assert_array_equal(cropped.matte, matte[top : top + height, left : left + width] / np.float32(255))
    assert cropped.matte.sum() == pytest.approx((matte / 255).sum())
    with pytest.raises(ValueError, match="matte: expected the camera's shape"):
        MeshView.cropped(image, matte[1:], camera)


def test_bad_arguments_are_named(views: list[MeshView]) -> None:
    """Catches messages that do not name the argument."""
    with pytest.raises(ValueError, match="views: expected at least one view"):
        texture_mesh(XYZ, FACES, [], 64)
    with pytest.raises(ValueError, match="triangles: expected at least one triangle"):
        texture_mesh(XYZ, FACES[:0], views, 64)
    with pytest.raises(ValueError, match="size: expected at least 16 texels"):
        texture_mesh(XYZ, FACES, views, 8)
    with pytest.raises(ValueError, match="xyz: expected finite vertices"):
        texture_mesh(XYZ * np.nan, FACES, views, 64)
