"""What is timed on a CUDA device: pictures and gradients put on its stream one after another, as in use."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from fourd.baking.gpu_player import GpuFrame, GpuPlayer
from fourd.benchmarks.cases import Case, composite
from fourd.benchmarks.machine import has_gpu
from fourd.benchmarks.timing import Work
from fourd.benchmarks.workloads import baked_figure, camera, figure, planes
from fourd.cameras import Camera
from fourd.model.plane_lookup import sample_planes, sample_planes_reference
from fourd.model.sources import SourceSamples, SourceViews, sample_sources, sample_sources_reference

PARTS = 20
"""Runs between two waits for the device."""

SIZES = ((1920, 1080), (3840, 2160))


def gpu_cases() -> Iterator[Case]:
    """All cases; none where there is no CUDA device, or no kernels for it."""
    if not has_gpu():
        return
    device = torch.device("cuda", torch.cuda.current_device())
    for count, view in ((65_536, camera(512, 512)), (262_144, camera(1920, 1080))):
        for backward in (False, True):
            yield _composite(device, count, view, 15, backward)
    for count in (262_144, 1_000_000):
        for size in SIZES:
            yield _play(device, count, camera(*size), 12)
    yield _lookup(device, 65_536)
    yield _sources(device, 65_536)


def repeated(work: Work) -> Work:
    """The work :data:`PARTS` times, and then one wait for the device."""

    def run() -> None:
        for _ in range(PARTS):
            work()
        torch.cuda.synchronize()

    return run


def _composite(device: torch.device, count: int, view: Camera, layers: int, backward: bool) -> Case:
    cloud = {name: array.to(device) for name, array in figure(count).items()}
    passes = "forward + backward" if backward else "forward"
    name = f"GPU: composite {count:,} points, {view.width} x {view.height}, K = {layers}, {passes}"
    return Case(name, repeated(composite(cloud, view, layers, backward)), parts=PARTS)


def _play(device: torch.device, count: int, view: Camera, layers: int) -> Case:
    frame, scene = baked_figure(count)
    player, held = GpuPlayer(device), GpuFrame.of(frame, device)
    out = player.draw(held, view, scene, layers=layers)
    name = f"GPU: play {count:,} points, {view.width} x {view.height}, K = {layers}: fp16 to RGBA8, 4 views + SH"
    return Case(name, repeated(lambda: player.draw(held, view, scene, layers=layers, out=out)), parts=PARTS)


def _lookup(device: torch.device, count: int) -> Case:
    made, axes = planes()
    leaves = [plane.to(device).requires_grad_() for plane in made]
    coordinates = torch.rand(count, 4, generator=torch.Generator().manual_seed(count)).to(device) * 2 - 1
    upstream = torch.ones(count, len(made) * made[0].shape[2], device=device)
    ours = repeated(lambda: torch.autograd.grad(sample_planes(coordinates, leaves, axes), leaves, upstream))
    torchs = repeated(lambda: torch.autograd.grad(sample_planes_reference(coordinates, leaves, axes), leaves, upstream))
    name = f"GPU: K-Planes, 4 levels x 6 x 8 features, {count:,} points, forward + backward"
    return Case(name, ours, {"torch grid_sample": torchs}, PARTS)


def _sources(device: torch.device, count: int) -> Case:
    generator = torch.Generator().manual_seed(count)

    def random(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator).to(device)

    cameras = tuple(camera(512, 512, 0.3 * view) for view in range(4))
    sources = SourceViews(random(4, 3, 512, 512), random(4, 512, 512), 4 * random(4, 512, 512), cameras)
    xyz = figure(count)["xyz"].to(device).requires_grad_()
    features = random(4, 16, 256, 256).requires_grad_()

    def both(sample: Callable[..., SourceSamples]) -> Work:
        def work() -> object:
            channels = sample(xyz, sources, features, 0.02).channels
            return torch.autograd.grad(channels.sum(), (xyz, features))

        return repeated(work)

    rivals = {"torch grid_sample": both(sample_sources_reference)}
    name = f"GPU: {count:,} points sampled in 4 views, 16 features + RGB, forward + backward"
    return Case(name, both(sample_sources), rivals, PARTS)
