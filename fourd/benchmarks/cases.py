"""Benchmark cases: kernels and training steps, with other implementations of the same computations."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field

import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.benchmarks.meshes import antialiasing, interpolating, make_mesh, project, rasterizing
from fourd.benchmarks.peers import pytorch3d_compositor, pytorch3d_rasterizer
from fourd.benchmarks.rays import ray_works
from fourd.benchmarks.soft_triangles import soft_silhouette, splatting
from fourd.benchmarks.textures import trilinear_texture
from fourd.benchmarks.timing import Work
from fourd.benchmarks.training_step import training_steps
from fourd.benchmarks.workloads import make_baked_frame, make_camera, make_cloud, make_planes
from fourd.reconstruction.model.appearance import ImageEncoder
from fourd.rendering import render_points
from fourd.rendering.ops.encoder.op import encode_images
from fourd.rendering.ops.encoder.reference import encode_images_reference
from fourd.rendering.ops.planes.op import sample_planes
from fourd.rendering.ops.planes.reference import sample_planes_reference
from fourd.rendering.ops.points.validation import pack_camera
from fourd.rendering.ops.similarity.op import structural_similarity
from fourd.rendering.ops.similarity.reference import structural_similarity_reference
from fourd.rendering.ops.sources.op import sample_sources
from fourd.rendering.ops.sources.reference import sample_sources_reference
from fourd.scene.player import Player

CPU = torch.device("cpu")
PASSES = ("forward", "backward")
SamplePlanes = Callable[[Tensor, list[Tensor], list[int]], Tensor]


@dataclass(frozen=True)
class Case:
    """One benchmark case, which is one row of the table.

    Attributes:
        name: description of the computation and its size.
        work: function that runs the computation ``repeats`` times.
        rivals: other implementations of the same computation, by name.
        repeats: number of times that ``work`` runs the computation. Timings are divided by ``repeats``.
    """

    name: str
    work: Work
    rivals: dict[str, Work] = field(default_factory=dict)
    repeats: int = 1


def cases(resources: ExitStack, *, steps: bool) -> Iterator[Case]:
    """Yield all cases, each created on demand. Temporary files are removed when ``resources`` is closed.

    Args:
        steps: whether to include whole training steps, for which a synthetic capture is made.
    """
    # The reference implementation is timed only in this small case, because its memory is proportional to the number of
    # points times the number of pixels.
    yield _composite(2_048, make_camera(96, 96), 15, True, reference=True)
    for backward in (False, True):
        yield _composite(65_536, make_camera(512, 512), 15, backward)
    yield _play(262_144, make_camera(1920, 1080), 12)
    yield _play(262_144, make_camera(1920, 1080), 12, ordered=True)
    yield _play(1_000_000, make_camera(1920, 1080), 12)
    yield plane_case(65_536, CPU)
    yield sampling_case(65_536, CPU)
    yield encoder_case(512, CPU)
    yield _similarity(512)
    yield from _meshes(100_000, 1024)
    yield _peer_mesh(10_000, 512)
    for name, work, rivals in ray_works(100_000, 1024):
        yield Case(name, work, rivals)
    silhouette = soft_silhouette(1_300, 256, 50)
    yield Case("soft silhouette, 1,300 triangles, 256 x 256, K = 50, forward + backward", silhouette)
    for backward in (False, True):
        yield Case(f"splat 100,000 triangles, 1024 x 1024, {PASSES[backward]}", splatting(100_000, 1024, backward))
    for backward in (False, True):
        passes = "backward" if backward else "forward, with mip levels"
        yield Case(
            f"trilinear texture 1024 x 1024 x 3, 1024 x 1024 pixels, {passes}", trilinear_texture(1024, backward)
        )
    if steps:
        for name, work in training_steps(resources):
            yield Case(name, work)


def composite(cloud: dict[str, Tensor], view: Camera, layers: int, backward: bool, backend: str = "auto") -> Work:
    """Return a function that renders a point cloud and, if ``backward``, computes the gradients with respect to all its
    arrays."""

    def work() -> object:
        free = {name: array.requires_grad_(backward) for name, array in cloud.items()}
        out = render_points(**free, camera=view, layers=layers, backend=backend)  # type: ignore[arg-type]
        if not backward:
            return out
        return torch.autograd.grad(out.features.sum() + out.alpha.sum(), list(free.values()))

    return work


def plane_case(count: int, device: torch.device) -> Case:
    """Return the case that samples K-Planes at random points and computes the gradient with respect to every plane."""
    tensors, axes = make_planes()
    leaves = [plane.to(device).requires_grad_() for plane in tensors]
    levels, features = len(tensors) // 6, tensors[0].shape[2]
    generator = torch.Generator().manual_seed(count)
    coordinates = torch.rand(count, 4, generator=generator) * 2 - 1
    coordinates[:, 3] = 0.3
    upstream = torch.randn(count, len(tensors) * features, generator=generator).to(device)
    coordinates = coordinates.to(device)

    def both(sample: SamplePlanes) -> Work:
        return lambda: torch.autograd.grad(sample(coordinates, leaves, axes), leaves, upstream)

    name = f"K-Planes, {levels} levels x 6 x {features} features, {count:,} points, forward + backward"
    return Case(name, both(sample_planes), {"torch grid_sample": both(sample_planes_reference)})


def sampling_case(count: int, device: torch.device) -> Case:
    """Return the case that samples four source views at projected points.

    The backward pass computes the gradients with respect to the points and the feature maps.
    """
    generator = torch.Generator().manual_seed(count)

    def random(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator).to(device)

    cameras = [number for view in range(4) for number in pack_camera(make_camera(512, 512, 0.3 * view))]
    views = (random(4, 3, 512, 512), random(4, 512, 512), 4 * random(4, 512, 512), cameras)
    xyz = make_cloud(count)["xyz"].to(device).requires_grad_()
    features = random(4, 16, 256, 256).contiguous(memory_format=torch.channels_last).requires_grad_()

    softness = torch.full((count,), 0.02, device=device)

    def both(sample: Callable[..., tuple[Tensor, Tensor]]) -> Work:
        def work() -> object:
            channels, _ = sample(xyz, features, *views, softness)
            return torch.autograd.grad(channels.sum(), (xyz, features))

        return work

    name = f"{count:,} points sampled in 4 views of 512 x 512, 16 features + RGB, forward + backward"
    return Case(name, both(sample_sources), {"torch grid_sample": both(sample_sources_reference)})


def _composite(count: int, view: Camera, layers: int, backward: bool, reference: bool = False) -> Case:
    cloud = make_cloud(count)
    passes = "forward + backward" if backward else "forward"
    rivals = {"torch reference": composite(cloud, view, layers, backward, "reference")} if reference else {}
    peer = pytorch3d_compositor(cloud, view, layers, backward)
    if peer is not None:
        rivals["pytorch3d"] = peer
    name = f"composite {count:,} points, {view.width} x {view.height}, K = {layers}, {passes}"
    return Case(name, composite(cloud, view, layers, backward), rivals)


def _play(count: int, view: Camera, layers: int, *, ordered: bool = False) -> Case:
    frame, scene = make_baked_frame(count, ordered=ordered)
    player = Player()
    out = player.draw(frame, view, scene, layers=layers)
    order = ", in Morton order" if ordered else ""
    name = f"play {count:,} points{order}, {view.width} x {view.height}, K = {layers}: fp16 to RGBA8, 4 views + SH"
    return Case(name, lambda: player.draw(frame, view, scene, layers=layers, out=out))


def _meshes(count: int, side: int) -> Iterator[Case]:
    size = f"{count:,} triangles, {side} x {side}"
    for backward in (False, True):
        name = f"rasterize {size}, with derivatives, {PASSES[backward]}"
        yield Case(name, rasterizing(count, side, backward))
    for backward in (False, True):
        yield Case(f"interpolate 3 channels, {size}, {PASSES[backward]}", interpolating(count, side, backward))
    for name, changes_image in (("antialias", True), ("edge gradients of", False)):
        name = f"{name} 3 channels, {size}, given topology, forward + backward"
        yield Case(name, antialiasing(count, side, changes_image=changes_image))


def encoder_case(side: int, device: torch.device) -> Case:
    """Return the case that encodes four images and computes the gradients of the encoder's weights."""
    encoder = ImageEncoder(8, 2).to(device)
    weights: list[Tensor] = list(encoder.parameters())
    images = torch.rand(4, 3, side, side, generator=torch.Generator().manual_seed(side)).to(device)

    def both(encode: Callable[[Tensor, list[Tensor], int], Tensor]) -> Work:
        return lambda: torch.autograd.grad(encode(images, weights, encoder.stride).sum(), weights)

    name = f"image encoder, 4 images of {side} x {side}, forward + backward"
    return Case(name, both(encode_images), {"torch conv2d": both(encode_images_reference)})


def _peer_mesh(count: int, side: int) -> Case:
    xyz, tri = make_mesh(count)
    peer = pytorch3d_rasterizer(project(xyz, side)[0], tri, side)
    rivals = {} if peer is None else {"pytorch3d": peer}
    return Case(f"rasterize {count:,} triangles, {side} x {side}, forward", rasterizing(count, side, False), rivals)


def _similarity(side: int) -> Case:
    generator = torch.Generator().manual_seed(side)
    truth = torch.rand(side, side, 3, generator=generator)
    picture = torch.rand(side, side, 3, generator=generator).requires_grad_()

    def both(compare: Callable[[Tensor, Tensor], Tensor]) -> Work:
        return lambda: torch.autograd.grad(compare(picture, truth), picture)

    name = f"structural similarity, {side} x {side} x 3, forward + backward"
    return Case(name, both(structural_similarity), {"torch conv2d": both(structural_similarity_reference)})
