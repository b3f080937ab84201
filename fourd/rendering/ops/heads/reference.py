"""The networks of the point model in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from fourd.rendering.ops.blend.reference import LOGIT_RANGE
from fourd.rendering.ops.heads.layers import NO_TIME_PLANES, HeadSettings, HeadWeights, TimePlanes
from fourd.rendering.ops.planes.reference import sample_planes_reference
from fourd.rendering.ops.shade.harmonics import SH_CONSTANT, SH_TERMS, directional_terms


def evaluate_heads_reference(
    features: Tensor,
    samples: Tensor,
    visibility: Tensor,
    view_weights: Tensor,
    own: Tensor | None,
    xyz: Tensor,
    spacing: Tensor,
    weights: HeadWeights,
    settings: HeadSettings,
    time_planes: TimePlanes = NO_TIME_PLANES,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Compute the result of :func:`fourd.rendering.ops.heads.op.evaluate_heads` on any device and in any dtype."""
    features = _with_time_features(features, time_planes)
    radius, density = _geometry(features, weights, settings)
    sh = torch.relu(functional.linear(features, weights.sh_first, weights.sh_first_bias))
    sh = functional.linear(sh, weights.sh_last, weights.sh_last_bias)
    logits = _logits(features, samples, weights)
    seen = torch.where(visibility < settings.min_visibility, 0, visibility)
    colours = samples[:, -3:].transpose(1, 2)
    if own is not None and settings.own_share > 0:
        colours = torch.lerp(colours, own.expand_as(colours), settings.own_share).clamp(0, 1)
    elif own is not None:
        colours = own.lerp(colours, seen[..., None])
    raw = torch.softmax(logits, dim=0) * seen * view_weights[:, None]
    total = raw.sum(dim=0)
    even = (view_weights / view_weights.sum())[:, None].expand_as(raw)
    shares = torch.where(total > 0, raw / torch.where(total > 0, total, torch.ones_like(total)), even)
    blended = (shares[..., None] * colours).sum(dim=0)
    directions = functional.normalize(xyz - torch.tensor(settings.centre).to(xyz), dim=-1)
    x, y, z = directions.unbind(-1)
    basis = torch.stack([torch.full_like(x, SH_CONSTANT), *directional_terms(x, y, z)], dim=-1)
    directional = torch.tanh((sh.reshape(-1, 3, SH_TERMS) * basis[:, None]).sum(dim=-1))
    return radius * spacing, density, sh, blended + settings.sh_range * directional


def _with_time_features(features: Tensor, time_planes: TimePlanes) -> Tensor:
    """Insert the features of time planes at their columns."""
    if time_planes.coordinates is None:
        return features
    times = torch.full_like(features[:, :1], time_planes.time)
    coordinates = torch.cat([time_planes.coordinates[:, :3], times], dim=1)
    rest, parts = features, list[Tensor]()
    ordered = sorted(
        zip(time_planes.columns, time_planes.planes, time_planes.axes, strict=True), key=lambda row: row[0]
    )
    for column, plane, axis in ordered:
        before = column - sum(part.shape[1] for part in parts)
        parts += [rest[:, :before], sample_planes_reference(coordinates, [plane], [axis, 3])]
        rest = rest[:, before:]
    return torch.cat([*parts, rest], dim=1)


def _geometry(features: Tensor, weights: HeadWeights, settings: HeadSettings) -> tuple[Tensor, Tensor]:
    hidden = torch.relu(functional.linear(features, weights.geometry_first, weights.geometry_first_bias))
    hidden = torch.relu(functional.linear(hidden, weights.geometry_second, weights.geometry_second_bias))
    size, density = functional.linear(hidden, weights.geometry_last, weights.geometry_last_bias).unbind(-1)
    share = torch.sigmoid(size + settings.radius_offset)
    radius = settings.radius_low + (settings.radius_high - settings.radius_low) * share
    return radius, torch.sigmoid(density + settings.density_offset)


def _logits(features: Tensor, samples: Tensor, weights: HeadWeights) -> Tensor:
    point = functional.linear(features, weights.blend_point, weights.blend_point_bias)
    hidden = torch.relu(point + samples.transpose(1, 2) @ weights.blend_image.T)
    raw = functional.linear(hidden, weights.blend_out, weights.blend_out_bias)[..., 0]
    return LOGIT_RANGE * torch.tanh(raw / LOGIT_RANGE)
