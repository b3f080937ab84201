"""Fit a signed distance function to silhouettes and depth images, and extract a mesh in every step.

    python examples/triangles/marching_tetrahedra.py --shape torus
    python examples/triangles/marching_tetrahedra.py --capture ../captures/fox_run --frame 9

The parameters are a signed distance and an offset for each vertex of a tetrahedral grid (DMTet, Shen et al. 2021). The
first surface is an ellipsoid that fills the grid. Unlike a mesh with fixed triangles, this surface can change its
topology: an ellipsoid becomes a torus.

At pixels outside the given silhouette, the front of the fitted surface is pushed away from the camera, as if the true
depth were behind the grid. Where the front reaches the back of the fitted surface, this part of the surface vanishes.
Antialiasing provides the gradient at the silhouettes. With ``--capture``, the silhouettes are the mattes of one frame
and there are no depth images.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro
from common import save
from shapes import Mesh, aeroplane, cameras_around, chamfer_distance, draw, mean_iou, shaded, torus
from torch import Tensor

from fourd.base.cameras import Array, Camera
from fourd.reconstruction.carving.bounds import Bounds, hull_bounds
from fourd.reconstruction.meshes.surface.grid import TetrahedralGrid, box_grid
from fourd.reconstruction.meshes.surface.losses import MeshTopology, laplacian_loss, normal_consistency_loss
from fourd.reconstruction.meshes.surface.marching import marching_tetrahedra
from fourd.reconstruction.meshes.views import MeshView
from fourd.recording.capture import open_capture
from fourd.rendering.triangles import Topology, antialias_construct_topology

MAX_OFFSET_CELLS = 0.4
"""Largest offset of a grid vertex along each axis, as a fraction of a grid cube's side. This limit prevents
tetrahedra from turning inside out."""

FIRST_RATE, LAST_RATE = 0.3, 0.01
"""Learning rate of the distances and the offsets at the start and at the end of the fit."""

HELD_OUT = 5
"""Every fifth camera of a capture is held out to measure the intersection over union."""


@dataclass(frozen=True)
class Arguments:
    """Options of the fit."""

    shape: Literal["torus", "aeroplane"] = "torus"
    """Object whose silhouettes and depth images are fitted."""
    capture: Path | None = None
    """Folder of a capture with mattes. The capture's subject is fitted instead of ``shape``."""
    frame: int = 0
    """Index of the frame of the capture, from 0."""
    cells: int = 24
    """Number of cubes along the longest side of the grid."""
    views: int = 32
    """Number of viewpoints from which ``shape`` is seen."""
    size: int = 96
    """Width and height of the images of ``shape``, in pixels."""
    steps: int = 300
    """Steps of Adam."""
    batch: int = 4
    """Viewpoints per step."""
    seed: int = 0
    """Seed of the order of the viewpoints."""
    picture: Path = Path("marching_tetrahedra.png")
    """Output image: the first surface, the fitted surface and, if ``shape`` is fitted, the true surface."""


@dataclass(frozen=True, eq=False)
class View:
    """A camera with the silhouette and the depth of the object in its image.

    Attributes:
        camera: pinhole camera.
        silhouette: (H, W) fraction of each pixel that the object covers.
        depth: (H, W) camera depth of the object. Where the silhouette is empty, the depth lies behind the grid. Unknown
            depths are NaN.
    """

    camera: Camera
    silhouette: Tensor
    depth: Tensor


@dataclass(frozen=True, eq=False)
class Problem:
    """Input of a fit: the views to which the surface is fitted, other views for the scores, a box around the object,
    and the true mesh if it is known.
    """

    views: list[View]
    others: list[View]
    bounds: Bounds
    true: Mesh | None


def main(arguments: Arguments) -> float:
    """Fit the surface. Returns the mean intersection over union in the views that the fit does not use."""
    problem = known_shape(arguments) if arguments.capture is None else subject(arguments.capture, arguments.frame)
    centre, half = problem.bounds.centre, problem.bounds.extent / 2
    grid = box_grid(centre - 1.2 * half, centre + 1.2 * half, arguments.cells)
    fit = Fit(grid, centre, 1.2 * half)
    first = fit.mesh()
    report("before", first, problem)
    fit.run(problem.views, arguments)
    last = fit.mesh()
    overlap = report("after", last, problem)
    # The camera with the widest crop shows the largest part of the subject.
    camera = max((view.camera for view in problem.others), key=lambda camera: camera.width / camera.height)
    camera = camera.rescale(320 / max(camera.width, camera.height))
    meshes = [first, last] if problem.true is None else [first, last, problem.true]
    save([shaded(mesh, camera) for mesh in meshes], arguments.picture, bottom_up=False)
    return overlap


class Fit:
    """The parameters of the surface and their optimisation."""

    def __init__(self, grid: TetrahedralGrid, centre: Array, half: Array) -> None:
        self.grid = grid
        relative = (grid.xyz - torch.from_numpy(centre).float()) / torch.from_numpy(half).float()
        # The initial surface is an ellipsoid. Lengths are multiples of the side of a grid cube. The signed distances
        # are clamped, so that few steps can change their sign.
        self.sdf = ((1 - relative.norm(dim=1)) * float(half.min()) / grid.side).clamp(-1, 1).requires_grad_()
        self.offset = torch.zeros_like(grid.xyz).requires_grad_()

    def surface(self) -> tuple[Tensor, Tensor]:
        """Return vertices (V, 3), differentiable, and triangles (T, 3) int32."""
        xyz = self.grid.xyz + MAX_OFFSET_CELLS * self.grid.side * torch.tanh(self.offset)
        surface = marching_tetrahedra(xyz, self.sdf, self.grid.tetrahedra)
        return surface.xyz, surface.triangles.int()

    def mesh(self) -> Mesh:
        """Return the surface without gradients."""
        with torch.no_grad():
            return Mesh(*self.surface())

    def run(self, views: list[View], arguments: Arguments) -> None:
        """Minimise the loss by Adam."""
        rng = np.random.default_rng(arguments.seed)
        optimizer = torch.optim.Adam([self.sdf, self.offset], lr=FIRST_RATE, betas=(0.9, 0.99))
        for step in range(arguments.steps):
            optimizer.param_groups[0]["lr"] = FIRST_RATE * (LAST_RATE / FIRST_RATE) ** (step / arguments.steps)
            mesh = Mesh(*self.surface())
            chosen = rng.choice(len(views), min(arguments.batch, len(views)), replace=False)
            topology = antialias_construct_topology(mesh.tri)
            differences = [self.difference(mesh, topology, views[view]) for view in chosen]
            loss = self.smoothness(mesh) + torch.stack(differences).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            with torch.no_grad():
                # The distances are kept small, so that few steps can change their sign. The border of the grid is kept
                # outside the object, so that the surface is closed.
                self.sdf.clamp_(-1, 1)
                self.sdf[self.grid.is_border] = -1
            if step % max(arguments.steps // 8, 1) == 0 or step == arguments.steps - 1:
                print(f"step {step}: loss {float(loss.detach()):.4f}, {len(mesh.tri)} triangles")

    def difference(self, mesh: Mesh, topology: Topology, view: View) -> Tensor:
        """Return the difference between the mesh and a view, divided by the number of pixels of the object. Depths are
        multiples of the side of a grid cube."""
        silhouette, depth = draw(mesh, view.camera, topology)
        compared = (depth.detach() > 0) & view.depth.isfinite()
        by_depth = (depth[compared] - view.depth[compared]).abs().sum() / self.grid.side
        by_silhouette = (silhouette - view.silhouette).square().sum()
        return (by_silhouette + 0.1 * by_depth) / view.silhouette.sum().clamp(min=1)

    def smoothness(self, mesh: Mesh) -> Tensor:
        """Return the weighted sum of the Laplacian term and the term for angles between neighbouring triangles."""
        topology = MeshTopology.of(mesh.tri, len(mesh.xyz))
        laplacian = laplacian_loss(mesh.xyz / self.grid.side, topology)
        return 0.1 * laplacian + 0.1 * normal_consistency_loss(mesh.xyz, mesh.tri, topology)


def known_shape(arguments: Arguments) -> Problem:
    """Return the silhouettes and depth images of a shape whose true mesh is known."""
    true = torus() if arguments.shape == "torus" else aeroplane()
    lower, upper = true.xyz.min(dim=0).values.double().numpy(), true.xyz.max(dim=0).values.double().numpy()
    bounds = Bounds(lower, upper)
    views = [see(true, camera, bounds) for camera in cameras_around(arguments.views, arguments.size)]
    return Problem(views, [see(true, camera, bounds) for camera in cameras_around(24, 128, turn=1.0)], bounds, true)


def see(mesh: Mesh, camera: Camera, bounds: Bounds) -> View:
    """Render the silhouette and the depth of a mesh, as seen by ``camera``. Pixels on the contour have no depth."""
    silhouette, depth = draw(mesh, camera)
    depth = torch.where((silhouette > 0) & (silhouette < 1), torch.nan, depth)
    return View(camera, silhouette, torch.where(silhouette == 0, depth_behind(camera, bounds), depth))


def subject(path: Path, frame: int) -> Problem:
    """Return the mattes of one frame of a capture, cropped to the subject."""
    capture = open_capture(path)
    mattes = [capture.mask(camera, frame) for camera in range(len(capture.cameras))]
    bounds = hull_bounds(mattes, capture.cameras)
    views = []
    for number, (camera, matte) in enumerate(zip(capture.cameras, mattes, strict=True)):
        cropped = MeshView.cropped(capture.image(number, frame), matte, camera)
        silhouette = torch.from_numpy(cropped.matte)
        behind = torch.full_like(silhouette, depth_behind(camera, bounds))
        views.append(View(cropped.camera, silhouette, torch.where(silhouette == 0, behind, torch.nan)))
    fitted = [view for number, view in enumerate(views) if number % HELD_OUT]
    return Problem(fitted, views[::HELD_OUT], bounds, None)


def depth_behind(camera: Camera, bounds: Bounds) -> float:
    """Return a camera depth that is behind the grid."""
    return float(np.linalg.norm(camera.centre - bounds.centre) + np.linalg.norm(bounds.extent))


def report(when: str, mesh: Mesh, problem: Problem) -> float:
    """Print the scores of a mesh. Returns the mean intersection over union in the views that the fit does not use."""
    overlap = mean_iou(mesh, [view.camera for view in problem.others], [view.silhouette for view in problem.others])
    text = f"{when}: intersection over union {overlap:.4f}"
    if problem.true is not None:
        text += f", Chamfer distance {chamfer_distance(mesh, problem.true):.4f} (length of the object: 2)"
    print(text)
    return overlap


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
