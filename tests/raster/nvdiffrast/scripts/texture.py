"""Fit a texture to a perspective picture of a textured plane. The lookups use mip levels."""

import nvdiffrast.torch as dr
import torch

torch.manual_seed(2)
dr.set_log_level(2)
glctx = dr.RasterizeGLContext(output_db=True, mode="manual")
glctx.set_context()
pos = torch.tensor([[[-1, -1, 0.5, 1], [1, -1, 0.5, 1], [1, 0.9, 3, 4], [-1, 0.9, 3, 4]]], dtype=torch.float32)
uv = torch.tensor([[[0, 0], [1, 0], [1, 1], [0, 1]]], dtype=torch.float32)
tri = torch.tensor([[0, 1, 2], [0, 2, 3]], dtype=torch.int32)
wanted = torch.rand(1, 32, 32, 3)


def render(tex, **mip):
    rast, rast_db = dr.rasterize(glctx, pos, tri, resolution=[48, 48])
    texc, texd = dr.interpolate(uv, rast, tri, rast_db=rast_db, diff_attrs="all")
    color = dr.texture(tex, texc, texd, filter_mode="linear-mipmap-linear", max_mip_level=4, **mip)
    return color * torch.clamp(rast[..., -1:], 0, 1)


with torch.no_grad():
    target = render(wanted)
tex = torch.full((1, 32, 32, 3), 0.5, requires_grad=True)
optimizer = torch.optim.Adam([tex], lr=3e-2)
losses = []
for _ in range(60):
    loss = ((render(tex) - target) ** 2).mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    losses.append(float(loss))
mip = dr.texture_construct_mip(wanted, max_mip_level=4)
glctx.release_context()
result = {
    "loss_before": losses[0],
    "loss_after": losses[-1],
    "mip_difference": float((render(wanted, mip=mip) - target).abs().max()),
    "log_level": dr.get_log_level(),
}
