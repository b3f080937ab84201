"""The neighbours of triangles on edges with any number of triangles, and the silhouettes that follow from them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

from fourd.rendering.ops.antialias.topology import opposite_vertices
from fourd.rendering.triangles import antialias, antialias_construct_topology, rasterize

BACKENDS = ("cpu", "reference")


def triangles(faces: object) -> Tensor:
    return torch.from_numpy(np.asarray(faces, np.int32).reshape(-1, 3))


def expected_opposite(tri: Tensor, vertices: int) -> list[list[int]]:
    """Build the table of edges one triangle after another: each edge keeps two different opposite vertices."""
    sides: dict[tuple[int, int], list[int]] = {}
    corners = [
        [(sorted((face[1], face[2])), face[0]), (sorted((face[2], face[0])), face[1]), (sorted(face[:2]), face[2])]
        if len(set(face)) == 3 and all(0 <= vertex < vertices for vertex in face)
        else []
        for face in tri.tolist()
    ]
    for (one, two), vertex in itertools.chain.from_iterable(corners):
        side = sides.setdefault((one, two), [])
        if len(side) < 2 and vertex not in side:
            side.append(vertex)
    out = []
    for edges in corners:
        row = [-1, -1, -1]
        for k, ((one, two), vertex) in enumerate(edges):
            side = sides[one, two]
            if vertex in side and len(side) == 2:
                row[k] = side[1 - side.index(vertex)]
        out.append(row)
    return out


def test_neighbours_equal_those_of_a_table_of_edges(rng: np.random.Generator) -> None:
    """Catches a wrong choice among the triangles of an edge: duplicates, more than two different ones, triangles that
    contain a vertex twice, and indices out of range."""
    for _ in range(60):
        vertices = int(rng.integers(3, 9))
        tri = triangles(rng.integers(-1, vertices + 2, (int(rng.integers(0, 40)), 3)))
        assert opposite_vertices(tri, vertices).tolist() == expected_opposite(tri, vertices)
    assert opposite_vertices(triangles([[0, 0, 1], [-1, 2, 3]])).tolist() == [[-1] * 3] * 2


def test_neighbours_do_not_depend_on_the_order_of_triangles_with_two_sides(rng: np.random.Generator) -> None:
    """Catches a double-sided mesh whose neighbours change when its triangles are listed in another order."""
    faces = trimesh.creation.icosphere(subdivisions=1).faces
    tri = triangles(np.concatenate((faces, faces[:, ::-1], faces[:30])))
    order = torch.from_numpy(rng.permutation(len(tri)))
    opposite = opposite_vertices(tri)
    assert (opposite >= 0).all()
    assert torch.equal(opposite_vertices(tri[order]), opposite[order])


def clip_of(points: object) -> Tensor:
    x, y, z = np.asarray(points, np.float64).T
    w = z + 3
    return torch.from_numpy(np.stack((1.9 * x, 1.9 * y, (w - 2.9) * 1.2, w), 1).astype(np.float32))[None]


def changed(pos: Tensor, tri: Tensor, backend: str, side: int = 96) -> tuple[Tensor, Tensor]:
    """Antialias an image in which every triangle has its own colour, except that duplicates of a triangle share one.
    Return the image and a mask of the pixels that change."""
    rast, _ = rasterize(pos, tri, (side, side))
    key = tri.sort(1).values.double() @ torch.tensor([1.0, 97.0, 9409.0], dtype=torch.float64)
    colours = torch.cat([torch.zeros(1), (key * 0.37 % 1).float() + 0.5])
    color = colours[rast[..., 3].long()][..., None]
    out = antialias(color, rast, pos, tri, backend=backend)  # type: ignore[arg-type]
    return out, (out != color).any(-1)


@pytest.mark.parametrize("backend", BACKENDS)
def test_double_sided_and_duplicated_faces_have_the_silhouettes_of_single_ones(
    backend: str, rng: np.random.Generator
) -> None:
    """Catches silhouettes at every inner edge of a surface whose faces occur more than once."""
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=0.9)
    pos = clip_of(sphere.vertices @ np.linalg.qr(rng.standard_normal((3, 3)))[0])
    single, outline = changed(pos, triangles(sphere.faces), backend)
    assert 30 < int(outline.sum()) < 200
    for copies in ((sphere.faces, sphere.faces[:, ::-1]), (sphere.faces,) * 3, (sphere.faces, sphere.faces[:50])):
        found, mask = changed(pos, triangles(rng.permutation(np.concatenate(copies))), backend)
        assert torch.equal(mask, outline)
        torch.testing.assert_close(found, single, rtol=0, atol=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_borders_of_an_open_surface_stay_silhouettes(backend: str) -> None:
    """Catches a duplicate that counts as the neighbour across an open edge."""
    pos = clip_of([[-0.7, -0.5, 0], [0.8, -0.45, 0], [0.75, 0.6, 0], [-0.6, 0.5, 0]])
    square = [[0, 1, 2], [0, 2, 3]]
    single, outline = changed(pos, triangles(square), backend)
    assert int(outline.sum()) > 100
    found, mask = changed(pos, triangles([*square, [2, 1, 0], [3, 2, 0]]), backend)
    assert torch.equal(mask, outline)
    torch.testing.assert_close(found, single, rtol=0, atol=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("wings", [2, 3])
def test_third_wing_of_an_edge_is_a_silhouette(backend: str, wings: int) -> None:
    """Catches a third triangle at an edge that hides, or has, a neighbour. The third wing is nearer than the first."""
    pos = clip_of([[0, -0.8, 0], [0, 0.8, 0], [0.9, 0, 0.0], [-0.9, 0, 0.0], [0.7, 0, -0.3]])
    tri = triangles([[0, 1, 2], [1, 0, 3], [0, 1, 4]][:wings])
    assert opposite_vertices(tri)[:, 2].tolist() == [3, 2, -1][:wings]
    _, mask = changed(pos, tri, backend)
    column = mask[0, 30:66, 46:50].any(1)
    assert bool(column.all()) if wings == 3 else not bool(column.any())


@pytest.mark.parametrize("backend", BACKENDS)
def test_topology_of_more_vertices_than_pos_has(backend: str) -> None:
    """Catches a read beyond the vertices when the topology was built before its triangles were checked."""
    pos = clip_of([[-0.7, -0.5, 0], [0.8, -0.45, 0], [0.75, 0.6, 0]])
    topology = antialias_construct_topology(triangles([[0, 1, 2], [1, 2, 900]]))
    one = triangles([[0, 1, 2], [0, 1, 2]])
    rast, _ = rasterize(pos, one, (16, 16))
    color = (rast[..., 3:] > 0).float()
    found = antialias(color, rast, pos, one, topology, backend=backend)  # type: ignore[arg-type]
    torch.testing.assert_close(found, antialias(color, rast, pos, one, backend=backend))  # type: ignore[arg-type]
