"""Cube maps: the orientation of faces, and seamless edges and corners."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.texture.cubes import face_axes, pad_cube
from fourd.rendering.triangles import texture

BACKENDS = ["cpu", "reference"]


def centres(size: int) -> Tensor:
    """Return the directions (6, N, N, 3) of all texel centres, on the cube [-1, 1]^3, in float64."""
    places = (2 * torch.arange(size, dtype=torch.float64) + 1) / size - 1
    t, s = torch.meshgrid(places, places, indexing="ij")
    s_axis, t_axis, normal = (face_axes(places)[:, k, None, None, :] for k in range(3))
    return normal + s[..., None] * s_axis + t[..., None] * t_axis


def look_up(tex: Tensor, directions: Tensor, backend: str, filter_mode: str = "linear") -> Tensor:
    uv = directions.to(torch.float32).reshape(1, 1, -1, 3)
    return texture(tex, uv, filter_mode=filter_mode, boundary_mode="cube", backend=backend)[0, 0]  # type: ignore[arg-type]


@pytest.mark.parametrize("backend", BACKENDS)
def test_faces_have_the_order_and_orientation_of_opengl(backend: str) -> None:
    """Catches swapped, mirrored or turned faces. The expected texels are from the table of the OpenGL specification."""
    tex = torch.arange(24.0).view(1, 6, 2, 2, 1)
    big, small = 1.0, 0.5
    directions = torch.tensor([[big, small, small], [-big, small, small], [small, big, small]])
    directions = torch.cat(
        [directions, torch.tensor([[small, -big, small], [small, small, big], [small, small, -big]])]
    )
    # (s, t) of the six faces: (-z, -y), (z, -y), (x, z), (x, -z), (x, -y), (-x, -y).
    texel = [0 + 0, 4 + 1, 8 + 3, 12 + 1, 16 + 1, 20 + 0]
    assert look_up(tex, directions, backend, "nearest").flatten().tolist() == texel


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_texel_centre_gives_its_texel(backend: str, rng: np.random.Generator) -> None:
    """Catches positions that are shifted by half a texel."""
    tex = torch.from_numpy(rng.standard_normal((1, 6, 8, 8, 2)).astype(np.float32))
    for filter_mode in ("nearest", "linear"):
        found = look_up(tex, 3 * centres(8), backend, filter_mode)
        torch.testing.assert_close(found.view(1, 6, 8, 8, 2), tex)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("size", [1, 2, 5])
def test_pictures_are_continuous_across_all_edges_and_corners(
    size: int, backend: str, rng: np.random.Generator
) -> None:
    """Catches a rotated or mirrored neighbour at any of the 12 edges, and discontinuities at the corners."""
    tex = torch.from_numpy(rng.standard_normal((1, 6, size, size, 1)).astype(np.float32))
    step = 1e-5
    checked = 0
    for first, second in itertools.combinations(range(3), 2):
        for signs in itertools.product((-1.0, 1.0), repeat=2):
            along = torch.linspace(-0.999, 0.999, 101, dtype=torch.float64)
            edge = torch.empty(101, 3, dtype=torch.float64)
            edge[:, first], edge[:, second], edge[:, 3 - first - second] = signs[0], signs[1], along
            sides = []
            for axis in (first, second):
                side = edge.clone()
                side[:, axis] *= 1 + step
                sides.append(look_up(tex, side, backend))
            torch.testing.assert_close(*sides, rtol=0, atol=1e-3)
            checked += 1
    assert checked == 12
    for corner in itertools.product((-1.0, 1.0), repeat=3):
        around = torch.tensor(corner, dtype=torch.float64) * (1 + step * torch.eye(3, dtype=torch.float64))
        values = look_up(tex, around, backend).flatten()
        assert float(values.max() - values.min()) < 1e-3
        three = centres(size).view(-1, 3)
        nearest = (three / three.norm(dim=1, keepdim=True) @ torch.tensor(corner, dtype=torch.float64)).topk(3).indices
        assert float(values[0]) == pytest.approx(float(tex.flatten()[nearest].mean()), abs=1e-3)


def test_padding_takes_the_nearest_texel_of_another_face() -> None:
    """Catches an error that the kernel and the reference have in common. The expected texels are found by a search over
    all texels of the cube.
    """
    size = 4
    numbers = torch.arange(6.0 * size * size).view(1, 6, size, size, 1)
    padded = pad_cube(numbers)[0, ..., 0]
    all_centres = centres(size).view(6, -1, 3)
    places = (2 * torch.arange(-1, size + 1, dtype=torch.float64) + 1) / size - 1
    axes = face_axes(places)
    for face, row, column in itertools.product(range(6), range(size + 2), range(size + 2)):
        outside = [k in (0, size + 1) for k in (row, column)]
        if sum(outside) != 1:
            continue
        s_axis, t_axis, normal = axes[face]
        wanted = normal + places[column] * s_axis + places[row] * t_axis
        distance = (all_centres - wanted).norm(dim=-1)
        distance[face] = 10
        assert padded[face, row, column] == int(distance.argmin())


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_level_of_a_cube_follows_from_the_angle(backend: str) -> None:
    """Catches derivatives of directions that are not projected onto the face."""
    levels = [torch.full((1, 6, 32 >> k, 32 >> k, 1), float(k)) for k in range(6)]
    # A step of 2 / 32 on the face is one texel. A direction of length 3 moves by three times the step. Changes along
    # the direction itself have no effect.
    direction = 3 * torch.tensor([0.2, -1.0, 0.4])
    by_x = 3 * torch.tensor([4 * 2 / 32, 0.0, 0.0]) + 0.3 * direction
    by_y = 3 * torch.tensor([0.0, 0.0, 2 / 32]) - 0.1 * direction
    da = torch.stack([by_x, by_y], -1).view(1, 1, 1, 6)
    found = texture(levels[0], direction.view(1, 1, 1, 3), da, mip=levels[1:], boundary_mode="cube", backend=backend)
    assert found.item() == pytest.approx(2, abs=1e-5)
