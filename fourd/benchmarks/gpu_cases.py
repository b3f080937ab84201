"""Benchmark cases on a CUDA device.

As in real use, calls are queued on the device's stream, and the host queues the next call without waiting for the
previous one.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch

from fourd.base.cameras import Camera
from fourd.benchmarks.cases import Case, composite, encoder_case, plane_case, sampling_case
from fourd.benchmarks.peers import gsplat_rasterizer
from fourd.benchmarks.timing import Work
from fourd.benchmarks.workloads import make_baked_frame, make_camera, make_cloud
from fourd.rendering.ops.gpu import has_gpu
from fourd.scene.gpu_player import GpuFrame, GpuPlayer

REPEATS = 20
"""Number of runs of a computation between two synchronizations with the device."""

SIZES = ((1920, 1080), (3840, 2160))


def gpu_cases() -> Iterator[Case]:
    """Yield the GPU cases, or none if fourd's CUDA kernels cannot run on this machine."""
    if not has_gpu():
        return
    device = torch.device("cuda", torch.cuda.current_device())
    for count, view in ((65_536, make_camera(512, 512)), (262_144, make_camera(1920, 1080))):
        for backward in (False, True):
            yield _composite(device, count, view, 15, backward)
    for count in (262_144, 1_000_000):
        for size in SIZES:
            yield _play(device, count, make_camera(*size), 12)
    yield _on_gpu(plane_case(65_536, device))
    yield _on_gpu(sampling_case(65_536, device))
    yield _on_gpu(encoder_case(512, device))


def repeat(work: Work) -> Work:
    """Return a function that calls ``work`` :data:`REPEATS` times and then synchronizes with the device."""

    def run() -> None:
        for _ in range(REPEATS):
            work()
        torch.cuda.synchronize()

    return run


def _composite(device: torch.device, count: int, view: Camera, layers: int, backward: bool) -> Case:
    cloud = {name: array.to(device) for name, array in make_cloud(count).items()}
    passes = "forward + backward" if backward else "forward"
    name = f"GPU: composite {count:,} points, {view.width} x {view.height}, K = {layers}, {passes}"
    peer = gsplat_rasterizer(cloud, view, backward)
    rivals = {} if peer is None else {"gsplat": repeat(peer)}
    return Case(name, repeat(composite(cloud, view, layers, backward)), rivals, REPEATS)


def _play(device: torch.device, count: int, view: Camera, layers: int) -> Case:
    frame, scene = make_baked_frame(count)
    player, held = GpuPlayer(device), GpuFrame.from_frame(frame, device)
    out = player.draw(held, view, scene, layers=layers)
    name = f"GPU: play {count:,} points, {view.width} x {view.height}, K = {layers}: fp16 to RGBA8, 4 views + SH"
    return Case(name, repeat(lambda: player.draw(held, view, scene, layers=layers, out=out)), repeats=REPEATS)


def _on_gpu(case: Case) -> Case:
    """Return a GPU case whose work and rivals (other implementations) run :data:`REPEATS` times per timing."""
    rivals = {name: repeat(work) for name, work in case.rivals.items()}
    return Case(f"GPU: {case.name}", repeat(case.work), rivals, REPEATS)
