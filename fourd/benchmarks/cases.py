"""What is timed: each case is a kernel or a stage, and what else does the same work."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field

import torch
from torch import Tensor

from fourd.baking.player import Player
from fourd.benchmarks.peers import pytorch3d_compositor
from fourd.benchmarks.timing import Work
from fourd.benchmarks.training_step import training_steps
from fourd.benchmarks.workloads import baked_figure, camera, figure, planes
from fourd.cameras import Camera
from fourd.model.plane_lookup import sample_planes, sample_planes_reference
from fourd.raster import render_points

Lookup = Callable[[Tensor, list[Tensor], list[int]], Tensor]


@dataclass(frozen=True)
class Case:
    """One row of the table.

    Attributes:
        name: what is done, with its size.
        work: does it once.
        rivals: others that do the same work, by name; timed where they are not too slow.
        parts: how often the work is done at a time.
    """

    name: str
    work: Work
    rivals: dict[str, Work] = field(default_factory=dict)
    parts: int = 1


def cases(resources: ExitStack, *, steps: bool) -> Iterator[Case]:
    """All cases, each made when it is asked for; ``resources`` cleans up after them.

    ``steps`` also times whole training steps, on a synthetic capture that is made first.
    """
    # The reference's memory grows with points times pixels: it is compared where both are few.
    yield _composite(2_048, camera(96, 96), 15, True, reference=True)
    for backward in (False, True):
        yield _composite(65_536, camera(512, 512), 15, backward)
    yield _play(262_144, camera(1920, 1080), 12)
    yield _play(1_000_000, camera(1920, 1080), 12)
    yield _lookup(65_536)
    if steps:
        for name, work in training_steps(resources):
            yield Case(name, work)


def composite(cloud: dict[str, Tensor], view: Camera, layers: int, backward: bool, backend: str = "auto") -> Work:
    """Rendering of a cloud, and with ``backward`` the gradients of all its arrays."""

    def work() -> object:
        free = {name: array.requires_grad_(backward) for name, array in cloud.items()}
        out = render_points(**free, camera=view, layers=layers, backend=backend)  # type: ignore[arg-type]
        if not backward:
            return out
        return torch.autograd.grad(out.features.sum() + out.alpha.sum(), list(free.values()))

    return work


def _composite(count: int, view: Camera, layers: int, backward: bool, reference: bool = False) -> Case:
    cloud = figure(count)
    passes = "forward + backward" if backward else "forward"
    rivals = {"torch reference": composite(cloud, view, layers, backward, "reference")} if reference else {}
    peer = pytorch3d_compositor(cloud, view, layers, backward)
    if peer is not None:
        rivals["pytorch3d"] = peer
    name = f"composite {count:,} points, {view.width} x {view.height}, K = {layers}, {passes}"
    return Case(name, composite(cloud, view, layers, backward), rivals)


def _play(count: int, view: Camera, layers: int) -> Case:
    frame, scene = baked_figure(count)
    player = Player()
    out = player.draw(frame, view, scene, layers=layers)
    name = f"play {count:,} points, {view.width} x {view.height}, K = {layers}: fp16 to RGBA8, 4 views + SH"
    return Case(name, lambda: player.draw(frame, view, scene, layers=layers, out=out))


def _lookup(count: int) -> Case:
    made, axes = planes()
    levels, features = len(made) // 6, made[0].shape[2]
    generator = torch.Generator().manual_seed(count)
    coordinates = torch.rand(count, 4, generator=generator) * 2 - 1
    coordinates[:, 3] = 0.3
    upstream = torch.randn(count, len(made) * features, generator=generator)

    def both(lookup: Lookup) -> Work:
        def work() -> object:
            leaves = [plane.requires_grad_() for plane in made]
            return torch.autograd.grad(lookup(coordinates, leaves, axes), leaves, upstream)

        return work

    name = f"K-Planes, {levels} levels x 6 x {features} features, {count:,} points, forward + backward"
    return Case(name, both(sample_planes), {"torch grid_sample": both(sample_planes_reference)})
