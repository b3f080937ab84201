"""Composite three transparent squares behind each other, in range mode."""

import nvdiffrast.torch as dr
import torch

glctx = dr.RasterizeCudaContext(device="cuda:0")
square = torch.tensor([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
pos = torch.cat([torch.cat([square, torch.tensor([[z, 1.0]]).expand(4, 2)], 1) for z in (0.4, -0.2, 0.1)])
tri = torch.cat([torch.tensor([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(3)]).int()
ranges = torch.tensor([[0, 6], [2, 2]], dtype=torch.int32)
alpha, order = torch.zeros(2, 16, 16, 1), []
with dr.DepthPeeler(glctx, pos, tri, [16, 16], ranges=ranges, grad_db=False) as peeler:
    for _ in range(4):
        rast, rast_db = peeler.rasterize_next_layer()
        alpha = alpha + (1 - alpha) * 0.5 * (rast[..., 3:] > 0).float()
        order.append([int(rast[image, 10, 6, 3]) for image in range(2)])
result = {"alpha": [float(alpha[image, 10, 6, 0]) for image in range(2)], "order": order}
