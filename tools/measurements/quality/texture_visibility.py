"""Compare three ways to decide which views see a texel: tracing rays, comparing rasterized depths, and no test at all.

    fourd mesh CAPTURE -o meshes/ --frames 0:1 --test-views 03,09,14
    python tools/measurements/quality/texture_visibility.py CAPTURE meshes/000000.glb --test-views 03,09,14

The program textures the mesh of the first frame in each way, and compares the results with the held-out views. Times
are CPU times of the visibility tests on one thread.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.pipeline.stages.mesh import mean_score, score_mesh
from fourd.reconstruction.meshes.texturing.atlas import Atlas, find_texels
from fourd.reconstruction.meshes.texturing.blending import blend_views
from fourd.reconstruction.meshes.texturing.inpainting import fill_between_charts, fill_vertices
from fourd.reconstruction.meshes.texturing.texture import TexturedMesh, read_textured_mesh
from fourd.reconstruction.meshes.texturing.visibility import Occluder
from fourd.reconstruction.meshes.views import MeshView, depth_image, mesh_views
from fourd.recording.capture import open_capture
from fourd.recording.capture.pictures.mask_source import frame_masks

Floats = NDArray[np.float32]
TOLERANCE_PX = 2.0


@dataclass(frozen=True, eq=False)
class Rays(Occluder):
    """Visibility by ray tracing, as in `fourd mesh`. ``seconds`` collects the CPU times of the calls."""

    seconds: list[float] = field(default_factory=list)

    def hides(self, xyz: Floats, normals: Floats, camera: Camera) -> NDArray[np.bool_]:
        start = time.process_time()
        hidden = self.test(xyz, normals, camera)
        self.seconds.append(time.process_time() - start)
        return hidden

    def test(self, xyz: Floats, normals: Floats, camera: Camera) -> NDArray[np.bool_]:
        return super().hides(xyz, normals, camera)


@dataclass(frozen=True, eq=False)
class Untested(Rays):
    """No visibility test, so that all points count as visible."""

    def test(self, xyz: Floats, normals: Floats, camera: Camera) -> NDArray[np.bool_]:
        return np.zeros(len(xyz), np.bool_)


@dataclass(frozen=True, eq=False)
class Rasterized(Rays):
    """Visibility by a rasterized depth map. A point is visible if its depth is at most d + t, where d is the smallest
    depth of the 3 x 3 pixels around the point, and t is a tolerance: the width of TOLERANCE_PX pixels at the point's
    depth, divided by the cosine of the angle between the viewing ray and the normal."""

    nearest: dict[Camera, Floats] = field(default_factory=dict)

    def test(self, xyz: Floats, normals: Floats, camera: Camera) -> NDArray[np.bool_]:
        if camera not in self.nearest:
            depths = depth_image(self.bvh.xyz, self.bvh.triangles, camera)
            self.nearest[camera] = cv2.erode(depths, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
        nearest = self.nearest[camera]
        rays = camera.centre - xyz
        cosine = (rays * normals).sum(axis=1) / np.linalg.norm(rays, axis=1)
        pixels, depth = camera.project(xyz)
        column, row = pixels.astype(np.intp).T
        return depth > nearest[row, column] + TOLERANCE_PX * depth / camera.intrinsics[1, 1] / cosine


def weld(mesh: TexturedMesh) -> tuple[Floats, NDArray[np.int64]]:
    """Merge vertices at the same position. Return the distinct positions (V, 3), and an array (N,) with the index of
    each mesh vertex's position."""
    xyz, index = np.unique(mesh.xyz, axis=0, return_inverse=True)
    return xyz, index.reshape(-1)


def texture(mesh: TexturedMesh, views: list[MeshView], occluder: Occluder) -> TexturedMesh:
    """Compute a new texture for a mesh: blend the images of all views for each texel. ``occluder`` decides which views
    see the texel."""
    size = len(mesh.texture)
    welded, source = weld(mesh)
    corners = source[mesh.triangles]
    normals = np.zeros_like(welded)
    normals[source] = mesh.normals
    texels = find_texels(Atlas(source, mesh.triangles, mesh.uv, 0), size)
    facing = texels.interpolate(normals, corners)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    rgb, weight = blend_views(texels.interpolate(welded, corners), facing, views, occluder)
    of_vertices, known = blend_views(welded, normals, views, occluder)
    of_vertices = fill_vertices(of_vertices, known > 0, corners)
    unseen = weight <= 0
    rgb[unseen] = texels.interpolate(of_vertices, corners)[unseen]
    print(f"{unseen.mean():.2%} of the texels unseen", end=", ")
    image = np.zeros((size, size, 3), np.float32)
    image[texels.covered] = rgb
    pixels = np.rint(fill_between_charts(image, texels.covered).clip(0, 1) * 255).astype(np.uint8)
    return TexturedMesh(mesh.xyz, mesh.triangles, mesh.normals, mesh.uv, pixels)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--test-views", required=True)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    test = arguments.test_views.split(",")
    whole = open_capture(arguments.capture)
    capture = open_capture(arguments.capture, views=[name for name in whole.names if name not in test])
    images = [capture.image(index, 0) for index in range(len(capture.names))]
    views = mesh_views(images, frame_masks(capture, 0), capture.cameras)
    mesh = read_textured_mesh(arguments.mesh)
    welded, source = weld(mesh)
    indices = [whole.names.index(name) for name in test]
    plain = Occluder.of(welded, source[mesh.triangles])
    for kind in (Rays, Rasterized, Untested):
        occluder = kind(plain.bvh, plain.offset)
        print(f"{kind.__name__}: ", end="")
        textured = texture(mesh, views, occluder)
        score = mean_score(score_mesh(textured, whole, indices, 0))
        print(f"{sum(occluder.seconds):.2f} s, {score.psnr:.3f} dB")


if __name__ == "__main__":
    main()
