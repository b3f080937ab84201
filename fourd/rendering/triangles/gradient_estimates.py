"""Gradient estimates for renderers that are not differentiable (public API)."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


@torch.no_grad()
def estimate_gradient(
    render: Callable[[Tensor], Tensor],
    loss: Callable[[Tensor], Tensor],
    params: Tensor,
    ids: Callable[[Tensor], Tensor],
    *,
    epsilon: float | Tensor,
    samples: int = 1,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Estimate the gradient of an image loss with respect to the parameters of the rendered primitives, from images
    with perturbed parameters (Deliot et al. 2024, "Transforming a non-differentiable rasterizer into a differentiable
    one with stochastic gradient estimation").

    Each sample renders two images, one with the parameters params + epsilon * s and one with params - epsilon * s,
    where the sign s is +1 or -1, chosen at random for each parameter. Let L_+ and L_- be a pixel's losses in the two
    images. For each primitive that the pixel shows in at least one of the two images, (L_+ - L_-) * s / (2 * epsilon)
    is added to the gradient of the primitive's parameters. The expected value of this estimate is approximately the
    gradient of the loss, smoothed over a distance of epsilon. Its noise is inversely proportional to the square root of
    ``samples``.

    Args:
        render: function that maps parameters to an image. It need not be differentiable, and is called twice per
            sample.
        loss: function that maps an image to one loss per pixel, of shape (H, W) or any other. The gradient is that of
            the sum of all pixels' losses.
        params: (N, ...) parameters of N primitives, floating point.
        ids: function that maps parameters to the integer indices of the primitives that each pixel shows. The result
            has the shape of the losses, or one more axis if a pixel shows several primitives. Negative values stand for
            no primitive. ``ids`` is called directly after ``render`` with the same parameters, so it can return indices
            that ``render`` has computed.
        epsilon: positive size of the perturbation, as a number or as a tensor that broadcasts to ``params``.
        samples: number of rendered image pairs, at least 1.
        generator: random generator on the device of ``params``. If None, torch's default generator is used.

    Returns:
        Gradient with the shape of ``params``, not differentiable.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
    """
    _check(params, epsilon, samples)
    total = torch.zeros_like(params)
    for _ in range(samples):
        signs = 2 * torch.randint(0, 2, params.shape, generator=generator, device=params.device).to(params) - 1
        losses, seen = [], []
        for direction in (signs, -signs):
            moved = params + epsilon * direction
            losses.append(loss(render(moved)))
            seen.append(_check_ids(ids(moved), losses[-1], len(params)))
        credit = _sum_by_primitive(losses[0] - losses[1], torch.cat(seen, 1), len(params)).to(params)
        total += credit.reshape(-1, *[1] * (params.ndim - 1)) * signs / (2 * epsilon)
    return total / samples


def _sum_by_primitive(differences: Tensor, seen: Tensor, count: int) -> Tensor:
    """For each primitive, sum the loss differences (P,) of the pixels that show it. ``seen`` (P, K) are the indices of
    the primitives that each pixel shows. A pixel that lists a primitive several times is counted once."""
    seen = seen.sort(1).values
    repeated = torch.zeros_like(seen, dtype=torch.bool)
    repeated[:, 1:] = seen[:, 1:] == seen[:, :-1]
    counted = (seen >= 0) & ~repeated
    values = differences.reshape(-1, 1).expand(-1, seen.shape[1])[counted]
    return torch.zeros(count, dtype=values.dtype, device=values.device).index_add(0, seen[counted], values)


def _check(params: Tensor, epsilon: float | Tensor, samples: int) -> None:
    if not isinstance(params, Tensor) or not params.dtype.is_floating_point or params.ndim < 1:
        found = f"{tuple(params.shape)} {params.dtype}" if isinstance(params, Tensor) else type(params).__name__
        raise TypeError(f"params: expected a floating-point tensor (N, ...), got {found}")
    if not bool((torch.as_tensor(epsilon) > 0).all()):
        raise ValueError(f"epsilon: expected values greater than 0, got {epsilon}")
    if samples < 1:
        raise ValueError(f"samples: expected at least 1, got {samples}")


def _check_ids(ids: Tensor, loss: Tensor, count: int) -> Tensor:
    """Check the result of ``ids``, and return it as (P, K) int64 for P pixels and K primitives per pixel."""
    if ids.dtype.is_floating_point or ids.dtype == torch.bool:
        raise TypeError(f"ids: expected integers, got {str(ids.dtype).removeprefix('torch.')}")
    if ids.shape[: loss.ndim] != loss.shape or ids.ndim > loss.ndim + 1:
        expected = f"the shape of the losses, {tuple(loss.shape)}, with or without one more axis"
        raise ValueError(f"ids: expected {expected}, got {tuple(ids.shape)}")
    if ids.numel() > 0 and int(ids.max()) >= count:
        raise ValueError(f"ids: expected primitives below {count}, got {int(ids.max())}")
    slots = ids.shape[-1] if ids.ndim > loss.ndim else 1
    return ids.long().reshape(loss.numel(), slots)
