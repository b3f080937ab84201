"""Train triangles with soft edges on one frame, by rasterization, ray tracing, or ray tracing with fisheye images.

    python tools/measurements/quality/train_triangles.py CAPTURE --test-views 03,09,14 --method raster|rays|fisheye

The program scores held-out views. All methods start with the same triangles and take the same number of steps.
Triangles are neither removed nor split. The fisheye images are resampled from the capture's images with an equidistant
lens model, which training also uses.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.reconstruction.carving.bounds import hull_bounds
from fourd.reconstruction.carving.carve import carve_frame
from fourd.reconstruction.carving.colour import colour_points
from fourd.reconstruction.meshes.triangle_fitting.schedule import SIGMA_RANGE, Phase
from fourd.reconstruction.meshes.triangle_fitting.settings import TriangleSettings
from fourd.reconstruction.meshes.triangle_fitting.soft import SoftFit
from fourd.reconstruction.meshes.triangle_fitting.soup import Soup, start_triangles, triangle_indices
from fourd.reconstruction.meshes.triangle_fitting.targets import Target
from fourd.reconstruction.meshes.views import mesh_views
from fourd.reconstruction.training.evaluation.scores import score_view
from fourd.recording.capture import open_capture
from fourd.rendering.rays import Bvh, splat_along_rays
from fourd.rendering.triangles import TriangleRender
from fourd.scene.lenses.lens import Fisheye, Pinhole

FISHEYE_DEG = 70.0
RaysOf = dict[Camera, tuple[Tensor, Tensor]]
"""Origins and directions (H, W, 3) of the rays of each camera."""


class RaySoup(Soup):
    """Triangles that are rendered by tracing rays. Cameras for which no rays are given are pinhole cameras."""

    def __init__(self, soup: Soup, rays: RaysOf) -> None:
        super().__init__(soup.corners.value.detach(), soup.colours.value.detach(), soup.spacing)
        self._rays = rays
        self._bvh: Bvh | None = None

    def render(self, camera: Camera, phase: Phase) -> TriangleRender:
        if camera not in self._rays:
            self._rays[camera] = pinhole_rays(camera)
        origins, directions = self._rays[camera]
        xyz, tri = self.corners.value.reshape(-1, 3), triangle_indices(len(self))
        self._bvh = Bvh.build(xyz, tri) if self._bvh is None else self._bvh.update(xyz)
        sigma = torch.full((len(self),), phase.sigma)
        values = self.colours.value, self.opacity(phase.floor), sigma
        found = splat_along_rays(self._bvh, xyz, *values, origins.reshape(-1, 3), directions.reshape(-1, 3))
        shape = origins.shape[:2]
        no_weights = torch.zeros(len(self))
        return TriangleRender(found.features.reshape(*shape, 3), found.alpha.reshape(shape), None, None, no_weights)


def pinhole_rays(camera: Camera) -> tuple[Tensor, Tensor]:
    """Return the rays (H, W, 3) through the pixel centres of a camera."""
    rays, shape = Pinhole().rays(camera), (camera.height, camera.width, 3)
    origins, directions = (np.array(array, np.float32).reshape(shape) for array in (rays.origins, rays.directions))
    return torch.from_numpy(origins), torch.from_numpy(directions)


def fisheye_target(camera: Camera, image: np.ndarray, matte: np.ndarray, rays: RaysOf) -> Target:
    """Resample an image (H, W, 3) and its matte to a fisheye image, and crop it to the subject. The rays of the cropped
    image are stored in ``rays``."""
    bundle = Fisheye(FISHEYE_DEG).rays(camera)
    directions = np.tile(camera.forward, (camera.height * camera.width, 1))
    directions[bundle.pixels] = bundle.directions
    pixels, depth = camera.project(camera.centre + directions)
    # In OpenCV, pixel centres have integer coordinates. For directions outside the image, the matte becomes 0.
    at = np.where(depth[:, None] > 1e-6, pixels - 0.5, -10).astype(np.float32).reshape(camera.height, camera.width, 2)
    warped = cv2.remap(np.dstack([image, matte]), at, None, cv2.INTER_LINEAR, borderValue=(0, 0, 0, 0))
    inside = np.zeros(len(directions), bool)
    inside[bundle.pixels] = True
    alpha = (warped[..., 3] * inside.reshape(camera.height, camera.width)).astype(np.float32) / 255
    left, top, width, height = cv2.boundingRect((alpha > 0.03).astype(np.uint8))
    part = np.s_[max(top - 16, 0) : top + height + 16, max(left - 16, 0) : left + width + 16]
    directions = directions.reshape(camera.height, camera.width, 3).astype(np.float32)[part]
    crop = camera.crop(part[1].start, part[0].start, directions.shape[1], directions.shape[0])
    rays[crop] = (
        torch.from_numpy(camera.centre.astype(np.float32)).expand(directions.shape).contiguous(),
        torch.from_numpy(np.ascontiguousarray(directions)),
    )
    mattes = torch.from_numpy(np.ascontiguousarray(alpha[part]))
    rgb = torch.from_numpy(np.ascontiguousarray(warped[part][..., :3])).float() / 255
    return Target(crop, rgb * mattes[..., None], mattes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--test-views", required=True)
    parser.add_argument("--method", choices=("raster", "rays", "fisheye"), required=True)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--triangles", type=int, default=8000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    generator = torch.Generator().manual_seed(arguments.seed)
    capture = open_capture(arguments.capture)
    test = [capture.names.index(name) for name in arguments.test_views.split(",")]
    training = [index for index in range(len(capture.names)) if index not in test]
    images, masks = ([read(index, 0) for index in training] for read in (capture.image, capture.mask))
    cameras = [capture.cameras[index] for index in training]
    names = [capture.names[index] for index in training]
    bounds = hull_bounds(masks, cameras, names=names).padded(0.05)
    hull = carve_frame(masks, cameras, bounds, points=arguments.triangles, seed=arguments.seed, names=names)
    colours = torch.from_numpy(colour_points(hull.xyz, hull.normals, hull.spacing, images, cameras)).float() / 255
    soup = Soup(start_triangles(hull.xyz, hull.normals, hull.spacing, generator), colours, hull.spacing)
    rays: RaysOf = {}
    if arguments.method == "fisheye":
        targets = [
            fisheye_target(camera, image, mask, rays)
            for camera, image, mask in zip(cameras, images, masks, strict=True)
        ]
    else:
        targets = [Target.of(view) for view in mesh_views(images, masks, cameras)]
    if arguments.method != "raster":
        soup = RaySoup(soup, rays)
    fit = SoftFit(soup, targets, TriangleSettings(max_steps=arguments.steps), generator)
    for step in range(arguments.steps):
        fit.step(Phase(SIGMA_RANGE[0], 0.0, 0.1 ** (step / arguments.steps), grows=False))
        if step % 20 == 19:
            print(f"step {step + 1}", flush=True)
    phase, boxes = Phase(SIGMA_RANGE[0], 0.0, 1.0, grows=False), []
    for index in test:
        matte = capture.mask(index, 0)
        truth = (capture.image(index, 0) * (matte[..., None] / (255.0 * 255.0))).astype(np.float32)
        with torch.no_grad():
            picture = soup.render(capture.cameras[index], phase).features.clamp(0, 1).numpy()
        boxes.append(score_view(picture, truth, matte, None)[1])
    print(f"{arguments.method}: " + ", ".join(f"{box.psnr:.2f}" for box in boxes if box is not None), end="; ")
    print(f"mean {np.mean([box.psnr for box in boxes if box is not None]):.2f} dB in the box of held-out views")


if __name__ == "__main__":
    main()
