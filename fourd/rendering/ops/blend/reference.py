"""Blend logits of source views in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

LOGIT_RANGE = 5.0
"""Blend logits lie in [-LOGIT_RANGE, LOGIT_RANGE], so that a baked scene can store their exponentials in float16."""


def blend_logits_reference(point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor) -> Tensor:
    """Compute the result of :func:`fourd.rendering.ops.blend.op.blend_logits` on any device and in any dtype."""
    hidden = torch.relu(point + samples.transpose(1, 2) @ weight.T)
    return LOGIT_RANGE * torch.tanh((hidden @ out + bias) / LOGIT_RANGE)
