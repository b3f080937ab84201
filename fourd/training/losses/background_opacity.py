"""What closes a background: it is opaque from wherever a viewer may stand, and not from its plates' cameras alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from fourd.cameras import Camera
from fourd.raster import render_points
from fourd.training.background import StaticBackground
from fourd.training.rendering import NEAR, visible_points

LAYERS = 64
"""Of a picture that is asked for holes: more than lie over one another on a floor seen at a grazing angle. Where the
last of too few layers leaves light, a gradient asks for larger discs, of which still fewer fit."""
ASTRAY = 0.15
"""A viewer stands so far beside the line between two cameras, at most, as a share of the line's length."""


def vantage(camera: Camera, others: Sequence[Camera], side_px: int, draw: np.random.Generator) -> Camera:
    """Part of a picture, at most ``side_px`` square, seen as ``camera`` does from somewhere on the way to another."""
    way = others[int(draw.integers(len(others)))].centre - camera.centre
    beside = draw.normal(size=3)
    beside *= ASTRAY * np.linalg.norm(way) * draw.random() / np.linalg.norm(beside)
    centre = camera.centre + draw.random() * way + beside
    width, height = min(side_px, camera.width), min(side_px, camera.height)
    left, top = draw.integers(camera.width - width + 1), draw.integers(camera.height - height + 1)
    return replace(camera, translation=-camera.rotation @ centre).crop(int(left), int(top), width, height)


def transparency(background: StaticBackground, viewer: Camera, hidden_weight: float) -> Tensor:
    """The mean square of what is left to see behind a background, differentiable in its model alone.

    Points keep their places: those are for the plates to say.
    """
    points, model = background.points, background.model
    rows = visible_points([points], viewer, LAYERS, hidden_weight)[0]
    xyz = points.xyz[rows]
    radius, density = model.geometry(model.point_features(xyz, 0.0), points.spacing[rows])
    alpha = render_points(xyz, torch.ones(len(rows), 1), radius, density, viewer, layers=LAYERS, near=NEAR).alpha
    return (1 - alpha).square().mean()
