"""Draw one triangle with vertex colours."""

import nvdiffrast.torch as dr
import torch

glctx = dr.RasterizeGLContext()
pos = torch.tensor([[[-0.8, -0.8, 0, 1], [0.8, -0.8, 0, 1], [-0.8, 0.8, 0, 1]]], dtype=torch.float32)
col = torch.tensor([[[1, 0, 0], [0, 1, 0], [0, 0, 1]]], dtype=torch.float32)
tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
rast, _ = dr.rasterize(glctx, pos, tri, resolution=[64, 64])
out, _ = dr.interpolate(col, rast, tri)
img = out.cpu().numpy()[0, ::-1]
result = {"covered": float((rast[..., 3] > 0).float().mean()), "top_left_blue": float(img[10, 8, 2])}
