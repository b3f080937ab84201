"""Surface smoothing: moves points towards planes through their neighbours, and moves isolated points back to their
neighbours.

The images determine a point's position accurately along the surface, but poorly along the normal. As an unwanted effect
of training, the points are therefore scattered along the normal, by about half a point spacing. In training views, the
colours of the points compensate for these displacements, but in novel views, contours become ragged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from fourd.reconstruction.training.memory import tensor_outside_heap
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.rendering.ops.moves import has_kernels, smooth_rows
from fourd.rendering.ops.neighbours import nearest_neighbours

NEIGHBOURS = 16
"""Number of points to which a point's plane is fitted, including the point itself."""
TOLERANCE = 0.25
"""Tolerance in point spacings. To preserve small details, points that are at most this far from their plane are not
moved."""
REFIT_STEPS = 40
"""The planes of a frame's points are fitted again after this number of training steps on the frame."""
ISOLATION_RANK = 8
"""Rank of the neighbour whose distance decides whether a point is isolated. The nearest neighbour has rank 1."""
ISOLATION_SPACINGS = 4.0
"""A point is isolated if its distance to the neighbour of rank ISOLATION_RANK exceeds this number of point spacings. If
points are spread evenly, this distance is about 2 spacings."""
MAX_SHARE = 0.5
"""One step reduces a point's excess distance by at most this fraction. The excess distance is the part of the distance
from the plane that exceeds the tolerance."""


def smooth_surface(points: FramePoints, rows: Tensor, rates: Tensor, strength: float) -> None:
    """Move the points ``rows`` towards the planes through their neighbours, in place.

    Whenever the planes are fitted again, each isolated point is moved to the mean position of its neighbours, because
    it would be visible as a speck beside the subject in novel views. The loss does not move isolated points back,
    because each image shows only few of them.

    A point's excess distance is the part of its distance from the plane that exceeds TOLERANCE point spacings. Each
    call reduces it by the fraction ``strength * rate / spacing``, where ``rate`` and ``spacing`` are the point's
    learning rate and spacing. Smoothing and the loss both move a point in proportion to its learning rate, so the
    balance between them does not depend on the learning rate.

    Args:
        points: the points of a frame or of the background. The planes are fitted again every REFIT_STEPS steps.
        rows: (M,) indices of the points to move.
        rates: (M, 1) learning rates of the positions in world units.
        strength: fraction by which the excess distance is reduced if the learning rate equals the point spacing. The
            reduction is clamped to MAX_SHARE.
    """
    if len(points.xyz) < NEIGHBOURS:
        return
    if points.local_planes is None or int(points.age) % REFIT_STEPS == 0:
        fit = fit_planes(points.xyz)
        points.local_planes = tensor_outside_heap(fit.planes)
        isolated = fit.reach > ISOLATION_SPACINGS * points.spacing
        points.parameters["xyz"][isolated] = fit.middle[isolated]
    if has_kernels(rows, points.xyz, points.local_planes, points.spacing, rates):
        limits = {"strength": strength, "tolerance": TOLERANCE, "max_share": MAX_SHARE}
        smooth_rows(rows, points.xyz, points.local_planes, points.spacing, rates, **limits)
        return
    xyz, planes, spacing = points.xyz[rows], points.local_planes[rows], points.spacing[rows]
    height = (planes[:, :3] * xyz).sum(dim=1) - planes[:, 3]
    excess = height - height.clamp(-TOLERANCE * spacing, TOLERANCE * spacing)
    share = (strength * rates[:, 0] / spacing).clamp(max=MAX_SHARE)
    points.parameters["xyz"][rows] = xyz - (share * excess)[:, None] * planes[:, :3]


@dataclass(frozen=True)
class LocalFit:
    """Planes and distances of N points.

    Attributes:
        planes: (N, 4) float32: unit normal n and offset d. The sign of n is arbitrary. A point x lies on the plane if
            dot(n, x) = d.
        reach: (N,) float32 distance to the neighbour of rank ISOLATION_RANK.
        middle: (N, 3) float32 mean position of the neighbours without the point itself.
    """

    planes: Tensor
    reach: Tensor
    middle: Tensor


def fit_planes(xyz: Tensor) -> LocalFit:
    """Fit a plane to the nearest neighbours of each point in ``xyz`` (N, 3), with N at least NEIGHBOURS. The planes are
    computed on the CPU and returned on the device of ``xyz``.

    The plane minimises the weighted sum of the neighbours' squared distances (principal component analysis). Near
    neighbours have larger weights than far ones.
    """
    data = xyz.detach().cpu().numpy()
    found = nearest_neighbours(data, data, NEIGHBOURS, threads=torch.get_num_threads())
    distance, near = np.asarray(found[0], dtype=np.float32), np.asarray(found[1])
    farthest = np.maximum(distance[:, -1:], np.finfo(np.float32).tiny)
    weight = np.exp(-2 * (distance / farthest) ** 2)[..., None]
    offsets = data[near] - data[:, None]
    mean = (weight * offsets).sum(axis=1, keepdims=True) / weight.sum(axis=1, keepdims=True)
    centred = torch.from_numpy((offsets - mean) / farthest[..., None])
    covariance = (torch.from_numpy(weight) * centred).transpose(1, 2) @ centred
    normal = torch.linalg.eigh(covariance).eigenvectors[:, :, 0]
    base = torch.from_numpy(data + mean[:, 0])
    planes = torch.cat([normal, (normal * base).sum(dim=1, keepdim=True)], dim=1)
    middle = torch.from_numpy(data + offsets[:, 1:].mean(axis=1))
    reach = torch.from_numpy(distance[:, ISOLATION_RANK])
    return LocalFit(planes.to(xyz.device), reach.to(xyz.device), middle.to(xyz.device))
