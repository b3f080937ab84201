"""Evaluation of points for a training step. Where the config allows it, one operator computes all networks of a point,
forward and backward."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.reconstruction.model.appearance import MIN_VISIBILITY
from fourd.reconstruction.model.geometry import DENSITY_OFFSET
from fourd.reconstruction.model.point_model import EvaluatedPoints, PointModel
from fourd.reconstruction.model.shadow import Shadow
from fourd.reconstruction.model.sources import OCCLUSION_FALLOFF_SPACINGS, SourceViews, sample_channels
from fourd.reconstruction.model.spherical_harmonics import SH_TERMS
from fourd.rendering.ops.blend.reference import LOGIT_RANGE
from fourd.rendering.ops.heads.layers import HeadSettings, HeadWeights
from fourd.rendering.ops.heads.op import evaluate_heads, has_heads_kernel


def evaluate_in_view(
    model: PointModel,
    xyz: Tensor,
    spacing: Tensor,
    time: float,
    viewer: Camera,
    sources: SourceViews | None,
    *,
    explicit_sh: Tensor | None = None,
    rgb: Tensor | None = None,
    shadow: Shadow | None = None,
    train_encoder: bool = True,
) -> tuple[EvaluatedPoints, Tensor]:
    """Compute the points and their colours (N, 3) as seen from ``viewer``, for a training step. The arguments are those
    of :meth:`PointModel.evaluate` and :meth:`PointModel.colour`, and so is the result, up to rounding errors. If one
    operator computes all networks, the result's ``features`` are None."""
    if sources is None or not has_fused_networks(model, xyz, shadow):
        evaluated = model.evaluate(xyz, spacing, time, explicit_sh=explicit_sh, rgb=rgb)
        return evaluated, model.colour(evaluated, viewer, sources, shadow=shadow, train_encoder=train_encoder)
    displaced, displacement = model.displace(xyz, time)
    encoded = model.encode_sources(sources, train_encoder=train_encoder)
    channels, visibility = sample_channels(displaced, sources, encoded, OCCLUSION_FALLOFF_SPACINGS * spacing)
    view_weights = visibility.new_ones(len(visibility)) if sources.weights is None else sources.weights
    features, time_planes = model.planes.split_features(model.coordinates(xyz.detach(), time), 2 * time - 1)
    radius, density, sh, colour = evaluate_heads(
        features,
        channels,
        visibility,
        view_weights,
        rgb,
        displaced,
        spacing,
        head_weights(model),
        _settings(model, viewer),
        time_planes,
    )
    sh = sh.view(-1, 3, SH_TERMS)
    return EvaluatedPoints(displaced, radius, density, spacing, displacement, None, sh, rgb), colour


def has_fused_networks(model: PointModel, xyz: Tensor, shadow: Shadow | None) -> bool:
    """Return true if one operator computes all networks of the points ``xyz``: on the CPU in float32, with both parts
    of the colour from MLPs, blend weights that do not depend on the viewing direction, and no shadow."""
    config = model.config
    has_layers = config.appearance == "both" and config.sh == "mlp" and not config.continuous
    return has_layers and shadow is None and has_heads_kernel(xyz, config.hidden)


def head_weights(model: PointModel) -> HeadWeights:
    """Return the weights of the heads of a model with all three heads."""
    geometry, blend, harmonics = model.geometry_head, model.blend_head, model.harmonics_head
    assert blend is not None
    assert harmonics is not None
    second, last = (layer for layer in geometry.layers if isinstance(layer, torch.nn.Linear))
    sh_last = harmonics.layers[-1]
    assert isinstance(sh_last, torch.nn.Linear)
    return HeadWeights(
        *(geometry.first.weight, geometry.first.bias, second.weight, second.bias, last.weight, last.bias),
        *(blend.point.weight, blend.point.bias, blend.image.weight, blend.out.weight, blend.out.bias),
        *(harmonics.first.weight, harmonics.first.bias, sh_last.weight, sh_last.bias),
    )


def _settings(model: PointModel, viewer: Camera) -> HeadSettings:
    head = model.geometry_head
    x, y, z = (float(each) for each in viewer.centre)
    return HeadSettings(
        radius_low=head.radius_low,
        radius_high=head.radius_high,
        radius_offset=head.radius_offset,
        density_offset=DENSITY_OFFSET,
        logit_range=LOGIT_RANGE,
        sh_range=model.sh_range,
        own_share=model.config.own_colour,
        min_visibility=MIN_VISIBILITY,
        centre=(x, y, z),
    )
