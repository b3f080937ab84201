"""Pruning and growth of triangles (Held et al. 2025, section 3.3)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.reconstruction.meshes.triangle_fitting.soup import Soup

MIN_WEIGHT = 0.022
"""A triangle is removed if its compositing weight has been below this number at all pixels since the last pruning."""
MIN_OPACITY = 0.014
GROWTH = 1.3
SPLIT_PX = 24.0
"""A triangle that is chosen for growth is split in four if its longest edge is longer than this number of pixels in at
least one training view. Otherwise, it is duplicated."""
CLONE_OFFSET = 0.2
"""The copy of a duplicated triangle is shifted at random along two of its edges. This number is the standard deviation
of each shift, as a fraction of the edge's length."""


@torch.no_grad()
def prune_and_grow(
    soup: Soup, weights: Tensor, priority: Tensor, cameras: Sequence[Camera], most: int, generator: torch.Generator
) -> None:
    """Remove the triangles that contribute almost nothing to the images. Then split or duplicate some of the remaining
    triangles, until the number of triangles is about GROWTH times the number after the removal, but at most ``most``.

    Args:
        soup: the triangles, which are changed in place.
        weights: (T,) maximum compositing weight of each triangle since the last call.
        priority: (T,) nonnegative numbers. The triangles to split or duplicate are selected at random, with
            probabilities proportional to these numbers.
        cameras: training cameras.
        most: maximum number of triangles.
        generator: random generator for this selection and for the offsets of duplicates.
    """
    opacity = soup.opacity(0.0)
    kept = torch.nonzero((weights >= MIN_WEIGHT) & (opacity > MIN_OPACITY))[:, 0]
    if len(kept) == 0:
        return
    wanted = min(int(GROWTH * len(kept)), most) - len(kept)
    is_large = longest_edges_px(soup.corners.value[kept], cameras) > SPLIT_PX
    # Splitting a triangle adds three triangles, and duplication adds one.
    order = torch.multinomial(priority[kept] + 1e-12, len(kept), generator=generator) if wanted > 0 else kept[:0]
    added = torch.cumsum(torch.where(is_large[order], 3, 1), 0)
    chosen = order[added <= wanted]
    grown = torch.zeros(len(kept), dtype=torch.bool)
    grown[chosen] = True
    split, cloned = kept[grown & is_large], kept[grown & ~is_large]
    corners, colours, logits = soup.corners.value, soup.colours.value, soup.logits.value
    # If a triangle with opacity o is duplicated, both copies get the opacity o' = 1 - sqrt(1 - o), so that together
    # they are as opaque as the original.
    halved = torch.logit(1 - (1 - opacity[cloned]).sqrt(), eps=1e-6)
    logits.data[cloned] = halved
    parts = torch.cat([_in_four(corners[split]), corners[cloned] + _offsets(corners[cloned], generator)])
    rows = torch.cat([split.repeat_interleave(4), cloned])
    remaining = kept[~(grown & is_large)]
    new_logits = torch.cat([logits[split].repeat_interleave(4), halved])
    soup.corners.replace(remaining, parts)
    soup.colours.replace(remaining, colours.detach()[rows])
    soup.logits.replace(remaining, new_logits)


def longest_edges_px(corners: Tensor, cameras: Sequence[Camera]) -> Tensor:
    """Return an approximate upper bound (T,), in pixels, on the length of each triangle's longest edge in the images of
    ``cameras``.

    For each camera, the length of the edge in world units is multiplied by the focal length and divided by the depth of
    the triangle's centre. The bound is the maximum over all cameras.
    """
    edge = (corners - corners[:, [1, 2, 0]]).norm(dim=2).amax(dim=1)
    centre = corners.mean(dim=1)
    scale = torch.zeros(len(corners))
    for camera in cameras:
        forward = torch.tensor(camera.forward.tolist(), dtype=centre.dtype)
        depth = centre @ forward + float(camera.translation[2])
        focal = float(max(camera.intrinsics[0, 0], camera.intrinsics[1, 1]))
        scale = torch.maximum(scale, torch.where(depth > 0, focal / depth, 0))
    return edge * scale


def _in_four(corners: Tensor) -> Tensor:
    """Split triangles (M, 3, 3) at the midpoints of their edges into triangles (4 * M, 3, 3)."""
    a, b, c = corners.unbind(1)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return torch.stack([torch.stack(part, dim=1) for part in parts], dim=1).reshape(-1, 3, 3)


def _offsets(corners: Tensor, generator: torch.Generator) -> Tensor:
    """Return random offsets (M, 1, 3) in the planes of triangles (M, 3, 3)."""
    edges = corners[:, 1:] - corners[:, :1]
    shares = CLONE_OFFSET * torch.randn(len(corners), 2, 1, generator=generator)
    return (edges * shares).sum(dim=1, keepdim=True)
