"""Fit the vertices and colours of a cube to pictures (16 x 16 pixels) of another cube."""

import itertools

import nvdiffrast.torch as dr
import torch

torch.manual_seed(1)
glctx = dr.RasterizeCudaContext()
corners = torch.tensor(list(itertools.product((-0.6, 0.6), repeat=3)))
faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
tri = torch.tensor([[a, b, c] for a, b, c, _ in faces] + [[a, c, d] for a, _, c, d in faces], dtype=torch.int32)
colours = (corners + 0.6) / 1.2
topology = dr.antialias_construct_topology_hash(tri)


def render(turns, vertices, vertex_colours):
    camera = torch.cat([turns @ vertices.T + torch.tensor([[[0.0], [0.0], [3.0]]]), torch.ones(len(turns), 1, 8)], 1)
    proj = torch.tensor([[2.0, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1.5, -2.5], [0, 0, 1, 0]])
    clip = (proj @ camera).transpose(1, 2).contiguous()
    rast, _ = dr.rasterize(glctx, clip, tri, resolution=(16, 16))
    color, _ = dr.interpolate(vertex_colours[None], rast, tri)
    color = torch.where(rast[..., 3:] > 0, color, torch.ones(()))
    return dr.antialias(color, rast, clip, tri, topology_hash=topology, pos_gradient_boost=1.0)


vertices = (corners + 0.15 * torch.randn(8, 3)).requires_grad_()
vertex_colours = torch.rand(8, 3).requires_grad_()
optimizer = torch.optim.Adam([vertices, vertex_colours], lr=1e-2)
errors = []
for _ in range(300):
    turns = torch.linalg.qr(torch.randn(8, 3, 3))[0]
    turns = turns * torch.linalg.det(turns)[:, None, None]
    with torch.no_grad():
        target = render(turns, corners, colours)
    loss = ((render(turns, vertices, vertex_colours) - target) ** 2).mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    errors.append(float((vertices.detach() - corners).norm(dim=1).mean()))
result = {"error_before": errors[0], "error_after": errors[-1]}
