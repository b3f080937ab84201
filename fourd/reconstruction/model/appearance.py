"""Appearance heads: image encoder, blend weights and spherical harmonics (4K4D, eq. 2 to 4)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from fourd.reconstruction.model.config import ModelConfig
from fourd.reconstruction.model.spherical_harmonics import SH_TERMS, sh_basis
from fourd.rendering.ops.blend.op import blend_logits
from fourd.rendering.ops.blend.reference import LOGIT_RANGE
from fourd.rendering.ops.encoder.op import encode_images

MIN_VISIBILITY = 1e-3
"""Visibility weights below this value are set to 0. The threshold limits the ratio between the weights of two views, so
that a baked scene, the exported form of a model, can store the weights in float16."""


class ImageEncoder(nn.Module):
    """Feature pyramid over the source images. The three levels of the pyramid have 8, 16 and 32 channels.

    The encoder maps V images (V, 3, H, W) in [0, 1] to features (V, image_features, H / stride, W / stride). H and W
    must be multiples of 4 * stride. An image crop has the same features as the whole image, except near the crop's
    border, because no layer normalises with statistics of the whole image.
    """

    def __init__(self, out_features: int, stride: int) -> None:
        super().__init__()
        self.stride = stride
        self.at_full = nn.Sequential(_convolution(3, 8), _convolution(8, 8))
        self.at_half = nn.Sequential(_convolution(8, 16, stride=2), _convolution(16, 16))
        self.at_quarter = nn.Sequential(_convolution(16, 32, stride=2), _convolution(32, 32))
        self.lateral_half = nn.Conv2d(16, 32, 1)
        self.lateral_full = nn.Conv2d(8, 16, 1)
        self.reduce = nn.Conv2d(32, 16, 1)
        self.out = nn.Conv2d(16, out_features, 3, padding=1)

    def forward(self, images: Tensor) -> Tensor:
        return encode_images(images, list(self.parameters()), self.stride)


class BlendHead(nn.Module):
    """MLP that predicts a blend logit for each point and source view.

    The input of the first layer is [point feature, image sample, optional direction]. The layer is split into one
    linear layer for each of these parts, whose outputs are added, so that the layer ``point`` is computed once per
    point instead of once per point and view. Because the split changes the order of summation, the logits differ from
    those of a single layer by rounding errors.
    """

    def __init__(self, point_features: int, image_channels: int, config: ModelConfig) -> None:
        super().__init__()
        self.point = nn.Linear(point_features, config.hidden)
        self.image = nn.Linear(image_channels, config.hidden, bias=False)
        self.direction = nn.Linear(4, config.hidden, bias=False) if config.continuous else None
        self.out = nn.Linear(config.hidden, 1)
        nn.init.uniform_(self.out.weight, -1e-2, 1e-2)
        nn.init.zeros_(self.out.bias)

    def forward(self, point: Tensor, samples: Tensor, directions: Tensor | None = None) -> Tensor:
        """Compute the blend logits (V, N), which are between -5 and 5.

        Args:
            point: (N, H) output of the layer ``point``.
            samples: (V, N, C) image samples.
            directions: (V, N, 4) relative directions; None if continuous blending is off.
        """
        if self.direction is None:
            return blend_logits(point, samples.transpose(1, 2), self.image.weight, self.out.weight[0], self.out.bias)
        assert directions is not None, "continuous blending needs directions"
        hidden = functional.relu(point + self.image(samples) + self.direction(directions))
        return LOGIT_RANGE * torch.tanh(self.out(hidden)[..., 0] / LOGIT_RANGE)


class HarmonicsHead(nn.Module):
    """MLP with one hidden layer that maps features (N, F) to degree-3 SH coefficients (N, 3, 16), which are initially
    near zero."""

    def __init__(self, in_features: int, config: ModelConfig) -> None:
        super().__init__()
        self.first = nn.Linear(in_features, config.hidden)
        self.layers = nn.Sequential(nn.ReLU(), nn.Linear(config.hidden, 3 * SH_TERMS))
        last = self.layers[-1]
        assert isinstance(last, nn.Linear)
        nn.init.uniform_(last.weight, -1e-3, 1e-3)
        nn.init.zeros_(last.bias)

    def forward(self, hidden: Tensor) -> Tensor:
        """Compute the SH coefficients (N, 3, 16) from the output (N, H) of the layer ``first``."""
        return self.layers(hidden).reshape(-1, 3, SH_TERMS)


def harmonics_colour(sh: Tensor, directions: Tensor, colour_range: float, base: float) -> Tensor:
    """Compute colours (N, 3) from the SH coefficients ``sh`` (N, 3, 16) and the unit directions d (N, 3). A colour is
    ``base + colour_range * tanh(sum_i sh_i * Y_i(d))``, where Y_i are the 16 SH basis functions."""
    return base + colour_range * torch.tanh((sh * sh_basis(directions)[:, None]).sum(-1))


def zero_low_visibility(visibility: Tensor) -> Tensor:
    """Replace visibility weights below MIN_VISIBILITY by 0. Visibility weights are in [0, 1]."""
    return torch.where(visibility < MIN_VISIBILITY, torch.zeros_like(visibility), visibility)


def mix_own_colours(colours: Tensor, visibility: Tensor, own: Tensor | None, share: float) -> Tensor:
    """Mix the colour that each source view shows at each point with the point's own colour, which is the same in all
    views.

    Let c be the colour of a point in a view, v the point's visibility in this view, and o the point's own colour:
    - If ``share`` is positive, the mixed colour is ``(1 - share) * c + share * o``, clamped to [0, 1], because baked
      scenes store mixed colours as bytes.
    - If ``share`` is 0, the mixed colour is ``v * c + (1 - v) * o``. The own colour thus replaces the view's colour if
      the point is occluded in the view. The model of the static background uses this formula.

    Args:
        colours: (V, N, 3) colours of the views in [0, 1].
        visibility: (V, N) visibility weights in [0, 1]. Weights below MIN_VISIBILITY count as 0.
        own: (N, 3) own colours of the points, which do not depend on the view. If None, the result is ``colours``.
        share: weight of the own colour in each mixed colour, in (0, 1), or 0 to mix according to visibility.

    Returns:
        (V, N, 3) mixed colours, differentiable in ``colours`` and ``own``.
    """
    if own is None:
        return colours
    if share > 0:
        return torch.lerp(colours, own.expand_as(colours), share).clamp(0, 1)
    return own.lerp(colours, zero_low_visibility(visibility)[..., None])


def blend(logits: Tensor, visibility: Tensor, colours: Tensor, view_weights: Tensor | None = None) -> Tensor:
    """Compute image-based colours as the weighted mean of the views' colours. A view's weight is its visibility times
    the softmax of its logit.

    Args:
        logits: (V, N).
        visibility: (V, N) visibility weights in [0, 1]. Weights below MIN_VISIBILITY count as 0.
        colours: (V, N, 3).
        view_weights: (V,) factors in [0, 1] that multiply the weights of the views, or None if all factors are 1.

    Returns:
        (N, 3) colours. A point that is visible in no view gets the mean of the views' colours, weighted by
        ``view_weights``. Baked scenes do the same for a point if all the weights that they store for it are 0.
    """
    visibility = zero_low_visibility(visibility)
    weights = torch.softmax(logits, dim=0) * visibility
    own = torch.ones_like(weights[:, 0]) if view_weights is None else view_weights
    if view_weights is not None:
        weights = weights * own[:, None]
    total = weights.sum(0)
    even = (own / own.sum())[:, None].expand_as(weights)
    weights = torch.where(total > 0, weights / torch.where(total > 0, total, torch.ones_like(total)), even)
    return (weights[..., None] * colours).sum(0)


def _convolution(channels_in: int, channels_out: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(channels_in, channels_out, 3, stride=stride, padding=1), nn.ReLU())
