"""Fits triangles to one frame of a capture, and scores the result in held-out views."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.progress import Log, Track, untracked
from fourd.reconstruction.carving.bounds import Bounds, hull_bounds
from fourd.reconstruction.carving.carve import carve_frame
from fourd.reconstruction.carving.colour import colour_points
from fourd.reconstruction.carving.hull import Silhouettes
from fourd.reconstruction.meshes.texturing.texture import colour_mesh
from fourd.reconstruction.meshes.triangle_fitting.connect import connect_triangles, visible_points
from fourd.reconstruction.meshes.triangle_fitting.opaque import ColouredMesh, mesh_image
from fourd.reconstruction.meshes.triangle_fitting.schedule import Budget, phase_at, surface_rate
from fourd.reconstruction.meshes.triangle_fitting.settings import TriangleSettings
from fourd.reconstruction.meshes.triangle_fitting.soft import SoftFit
from fourd.reconstruction.meshes.triangle_fitting.soup import Soup, start_triangles, triangle_indices
from fourd.reconstruction.meshes.triangle_fitting.surface import SurfaceFit
from fourd.reconstruction.meshes.triangle_fitting.targets import Target
from fourd.reconstruction.meshes.views import MeshView, mesh_views
from fourd.reconstruction.training.cameras.selection import RunViews
from fourd.reconstruction.training.evaluation.scores import Evaluation, ViewScores, score_view, summarize

BOUNDS_MARGIN = 0.03
"""Margin of the box around the hull, as a fraction of the box's longest side."""
START_SHARE = 0.5
"""The fit starts with this fraction of the maximum number of triangles."""
PERCENT = 100

Picture = Callable[[Camera], NDArray[np.float32]]
"""Function that renders a camera's image on a black background as colours (H, W, 3) in [0, 1]."""


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """The result of a fit.

    Attributes:
        mesh: the opaque mesh.
        steps: number of completed optimization steps.
        soft: scores, in held-out views, of the triangles at the end of the soft phase, in which they can be translucent
            and fade towards their edges. None if there are no held-out views or if the fit has no soft phase.
        opaque: scores of the mesh in held-out views, or None if there are no held-out views.
        is_interrupted: whether Ctrl-C ended the fit early.
    """

    mesh: ColouredMesh
    steps: int
    soft: Evaluation | None
    opaque: Evaluation | None
    is_interrupted: bool


def fit_frame(
    views: RunViews, settings: TriangleSettings, track: Track = untracked, log: Log = lambda line: None
) -> FittedFrame:
    """Fit triangles to the first frame of a capture.

    Soft triangles are placed on the visual hull of the training views' mattes, and gradually become opaque while they
    are fitted. They are then joined into a closed, opaque mesh (unless ``settings.connect`` is False), which is fitted
    further. The first KeyboardInterrupt ends the fit early.

    Args:
        views: the capture with mattes, and its training and held-out cameras.
        settings: number of triangles, budget and seed.
        track: callback that reports progress.
        log: called with one line if cameras without mattes are not used.

    Raises:
        UserError: if the capture has no mattes, or the hull is empty.
    """
    views.capture.select(views.training).with_mattes(log)
    masked = views.capture.masked
    training, test = ([index for index in indices if index in masked] for indices in (views.training, views.test))
    views = replace(views, training=training, test=test)
    fit = _FrameFit(views, settings)
    is_interrupted = False
    try:
        for _ in track(fit.run(), PERCENT, "percent of the fit"):
            pass
    except KeyboardInterrupt:
        is_interrupted = True
        fit.budget.close()
    mesh = fit.finish()
    opaque = _evaluate(views, lambda camera: mesh_image(mesh, camera)) if views.test else None
    return FittedFrame(mesh, fit.budget.steps, fit.soft_scores, opaque, is_interrupted)


class _FrameFit:
    """The state of a fit of one frame."""

    def __init__(self, views: RunViews, settings: TriangleSettings) -> None:
        self.budget = Budget(settings.max_steps, settings.max_seconds)
        self.soft_scores: Evaluation | None = None
        self._views, self._settings = views, settings
        self._generator = torch.Generator().manual_seed(settings.seed)
        self._cropped = _training_views(views)
        self._targets = [Target.of(view) for view in self._cropped]
        self._bounds = self._hull_bounds()
        self._soft = SoftFit(self._start(), self._targets, settings, self._generator)
        self._surface: SurfaceFit | None = None

    def run(self) -> Iterator[int]:
        """Fit until the budget is spent. Yield the spent percentage of the budget at each whole percent."""
        percent, is_scored = 0, False
        while (share := self.budget.share) < 1:
            if not is_scored and share >= self._settings.soft_share:
                is_scored = True
                self._score_soft()
            self._step(share)
            while percent < int(PERCENT * share):
                percent += 1
                yield percent
        if not is_scored:
            self._score_soft()
        while percent < PERCENT:
            percent += 1
            yield percent

    def finish(self) -> ColouredMesh:
        """Return the mesh for the current state of the fit."""
        if self._surface is None:
            self._surface = self._opaque()
        return self._surface.mesh()

    def _step(self, share: float) -> None:
        if share < self._settings.hard_share:
            self._soft.step(phase_at(share, self._settings))
        else:
            if self._surface is None:
                self._surface = self._opaque()
            self._surface.step(surface_rate(share, self._settings))
        self.budget.steps += 1

    def _hull_bounds(self) -> Bounds:
        return hull_bounds(
            self._masks(),
            self._cameras(),
            agreement=self._settings.agreement,
            least_views=self._settings.least_views,
            names=self._views.training_names,
            label=self._label(),
        ).padded(BOUNDS_MARGIN)

    def _start(self) -> Soup:
        """Place triangles on the surface of the visual hull."""
        settings, capture = self._settings, self._views.capture
        hull = carve_frame(
            self._masks(),
            self._cameras(),
            self._bounds,
            points=max(8, int(START_SHARE * settings.triangles)),
            agreement=settings.agreement,
            least_views=settings.least_views,
            seed=settings.seed,
            names=self._views.training_names,
            label=self._label(),
        )
        images = [capture.image(index, 0) for index in self._views.training]
        colours = colour_points(hull.xyz, hull.normals, hull.spacing, images, self._cameras())
        corners = start_triangles(hull.xyz, hull.normals, hull.spacing, self._generator)
        return Soup(corners, torch.from_numpy(colours).float() / 255, hull.spacing)

    def _opaque(self) -> SurfaceFit:
        """Start the fit of the opaque mesh, with joined or separate triangles."""
        soup = self._soft.soup
        corners, colours = soup.corners.value.detach(), soup.colours.value.detach()
        if self._settings.connect:
            side = float(self._bounds.extent.max()) / self._settings.cells
            mesh = self._connected(corners, side)
        else:
            side = soup.spacing
            mesh = (corners.reshape(-1, 3), colours.repeat_interleave(3, dim=0), triangle_indices(len(soup)))
        return SurfaceFit(mesh, side, self._targets, self._settings, self._generator)

    def _connected(self, corners: Tensor, side: float) -> tuple[Tensor, Tensor, Tensor]:
        settings = self._settings
        hull = Silhouettes.from_masks(
            self._masks(),
            self._cameras(),
            self._bounds.centre,
            agreement=settings.agreement,
            least_views=settings.least_views,
        )
        points = visible_points(corners, self._cameras())
        if len(points.xyz) > 0:
            xyz, tri = connect_triangles(points, hull, side)
        if len(points.xyz) == 0 or len(tri) == 0:
            raise UserError(
                f"{self._label()}: expected a surface of the fitted triangles, got none; raise --triangles or --cells"
            )
        _, rgb = colour_mesh(xyz.numpy(), tri.numpy(), self._cropped)
        return xyz, torch.from_numpy(rgb).float() / 255, tri

    @torch.no_grad()
    def _score_soft(self) -> None:
        if not self._views.test or self._settings.soft_share == 0:
            return
        soup, phase = self._soft.soup, phase_at(0.0, self._settings)
        with self.budget.paused():
            self.soft_scores = _evaluate(
                self._views, lambda camera: soup.render(camera, phase).features.clamp(0, 1).numpy()
            )

    def _masks(self) -> list[NDArray[np.uint8]]:
        return [self._views.capture.mask(index, 0) for index in self._views.training]

    def _cameras(self) -> list[Camera]:
        return [self._views.capture.cameras[index] for index in self._views.training]

    def _label(self) -> str:
        return f"{self._views.capture.path} frame {self._views.capture.frame_numbers[0]}"


def _training_views(views: RunViews) -> list[MeshView]:
    capture = views.capture
    images, masks = ([read(index, 0) for index in views.training] for read in (capture.image, capture.mask))
    return mesh_views(images, masks, [capture.cameras[index] for index in views.training])


def _evaluate(views: RunViews, picture: Picture) -> Evaluation:
    """Compute the scores in the held-out views."""
    capture, scored = views.capture, []
    for index in views.test:
        matte = capture.mask(index, 0)
        truth = (capture.image(index, 0) * (matte[..., None] / (255.0 * 255.0))).astype(np.float32)
        image, box = score_view(picture(capture.cameras[index]), truth, matte, None)
        scored.append(ViewScores(capture.names[index], capture.frame_numbers[0], image, box))
    return summarize(scored)
