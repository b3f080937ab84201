"""The points of one frame or of the background: their optimised parameters, optimizer state and gradient history."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.reconstruction.training.memory import tensor_outside_heap
from fourd.reconstruction.training.points.selective_adam import SelectiveAdam

INITIAL_DENSITY = 0.99
HISTORY = {
    "gradient_sum": "error",
    "visible_steps": "shown",
    "created_at": "born",
    "is_permanent": "lasting",
    "age": "age",
    "initial_count": "first",
}
"""Attribute of the gradient history -> name of its tensor in files."""


@dataclass
class FramePoints:
    """N points. Tensors are float32 unless another dtype is given.

    Attributes:
        spacing: (N,) distance between each point and its neighbours in world units. Radii are proportional to the
            spacing.
        radius: (N,) radii in world units that the model computed last; used for occlusion tests.
        density: (N,) densities in (0, 1) that the model computed last; used for occlusion tests.
        parameters: name -> optimised tensor: the positions "xyz" (N, 3) in world units, the coefficients "sh" (N, 48)
            of explicit SH, and the view-independent colours "rgb" (N, 3). "sh" and "rgb" are optional.
        optimizer: Adam's state for the parameters.
        gradient_sum: (N,) sum of gradient magnitudes over training steps; see ``accumulate_gradient_magnitudes``.
        visible_steps: (N,) number of training steps in which the point had a gradient.
        created_at: (N,) value of ``age`` when the point was created.
        is_permanent: (N,) bool, whether densification keeps the point even if it never gets a gradient.
        age: scalar, number of training steps on these points.
        initial_count: scalar, number of points before training.
        local_planes: (N, 4) planes fitted to the neighbours of each point; see ``fit_planes``. None before the first
            fit. When points are added or removed, it becomes None until the next fit.
    """

    spacing: Tensor
    radius: Tensor
    density: Tensor
    parameters: dict[str, Tensor]
    optimizer: SelectiveAdam
    gradient_sum: Tensor
    visible_steps: Tensor
    created_at: Tensor
    is_permanent: Tensor
    age: Tensor
    initial_count: Tensor
    local_planes: Tensor | None = None

    @property
    def xyz(self) -> Tensor:
        return self.parameters["xyz"]

    @classmethod
    def initial(
        cls, xyz: Tensor, spacing: Tensor, radius: float, *, explicit_sh: bool, rgb: Tensor | None = None
    ) -> FramePoints:
        """Create untrained points.

        Args:
            xyz: (N, 3) positions.
            spacing: (N,) distance between each point and its neighbours in world units.
            radius: radius of each point, as a multiple of the point's spacing.
            explicit_sh: whether each point has its own optimised SH coefficients, which are initially zero.
            rgb: (N, 3) initial view-independent colours; None for points without view-independent colours.
        """
        count = xyz.shape[0]
        parameters = {"xyz": xyz.clone()}
        if explicit_sh:
            parameters["sh"] = torch.zeros(count, 48)
        if rgb is not None:
            parameters["rgb"] = rgb.clone()
        return cls(
            spacing=spacing.clone(),
            radius=radius * spacing,
            density=torch.full((count,), INITIAL_DENSITY),
            parameters=parameters,
            optimizer=SelectiveAdam.initial(parameters),
            **_empty_history(count),
        )

    def keep_and_insert(self, kept: Tensor, parents: Tensor | None = None, partners: Tensor | None = None) -> None:
        """Remove all points except ``kept``, and append new points midway between pairs of points, in place.

        A new point gets the mean parameters of its pair, and the spacing, radius and density of the first point of the
        pair.

        Args:
            kept: (K,) indices of the points to keep.
            parents: (P,) index of the first point of each pair.
            partners: (P,) index of the second point of each pair.
        """
        first = kept[:0] if parents is None else parents
        second = first if partners is None else partners
        zeros = self.spacing.new_zeros(len(first))
        for name, value in self.parameters.items():
            mean = (value[first] + value[second]) / 2
            self.parameters[name] = tensor_outside_heap(torch.cat([value[kept], mean]))
        self.optimizer.keep_rows(kept, len(first))
        for name in ("spacing", "radius", "density"):
            value = getattr(self, name)
            setattr(self, name, tensor_outside_heap(torch.cat([value[kept], value[first]])))
        for name in ("gradient_sum", "visible_steps"):
            setattr(self, name, tensor_outside_heap(torch.cat([getattr(self, name)[kept], zeros])))
        self.created_at = torch.cat([self.created_at[kept], zeros + self.age])
        self.is_permanent = torch.cat([self.is_permanent[kept], self.is_permanent[first]])
        self.local_planes = None

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of the points. The keys are their names in files."""
        named = {name: getattr(self, name) for name in ("spacing", "radius", "density")}
        named["steps"] = self.optimizer.steps
        if self.local_planes is not None:
            named["local_planes"] = self.local_planes
        named.update({stored: getattr(self, name) for name, stored in HISTORY.items()})
        named.update({f"free.{name}": value for name, value in self.parameters.items()})
        named.update({f"moments.{name}": value for name, value in self.optimizer.moments.items()})
        return named

    @classmethod
    def from_tensors(cls, named: Mapping[str, Tensor]) -> FramePoints:
        """Create points from the output of :meth:`tensors`. If ``named`` contains no gradient history, the history is
        empty."""
        history = _empty_history(named["steps"].shape[0])
        history.update({name: named[stored] for name, stored in HISTORY.items() if stored in named})
        return cls(
            spacing=named["spacing"],
            radius=named["radius"],
            density=named["density"],
            parameters=_strip_prefix("free.", named),
            optimizer=SelectiveAdam(_strip_prefix("moments.", named), named["steps"]),
            local_planes=named.get("local_planes"),
            **history,
        )

    def copy_outside_heap(self) -> FramePoints:
        """Copy all tensors on the CPU to memory outside the heap. Points that stay in memory for many training steps
        would otherwise fragment the heap; see :mod:`fourd.reconstruction.training.memory`."""
        return self.from_tensors({name: tensor_outside_heap(value) for name, value in self.tensors().items()})

    def to(self, device: torch.device) -> FramePoints:
        """Return the points with their tensors on ``device``. The scalars ``age`` and ``initial_count`` stay on the
        CPU, so that reading them does not wait for a GPU."""
        return self.from_tensors(
            {name: value.to(device) if value.ndim else value.cpu() for name, value in self.tensors().items()}
        )

    @property
    def nbytes(self) -> int:
        return sum(value.numel() * value.element_size() for value in self.tensors().values())


def _empty_history(count: int) -> dict[str, Tensor]:
    history = {name: torch.zeros(count) for name in ("gradient_sum", "visible_steps", "created_at")}
    history["is_permanent"] = torch.zeros(count, dtype=torch.bool)
    history["age"] = torch.zeros(())
    history["initial_count"] = torch.tensor(float(count))
    return history


def _strip_prefix(prefix: str, named: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in named.items() if name.startswith(prefix)}
