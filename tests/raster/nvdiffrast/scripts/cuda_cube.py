"""Fit the size and the colours of a cube, with every tensor on a CUDA device."""

import argparse
import itertools
import sys

import numpy as np
import nvdiffrast.torch as dr
import torch

parser = argparse.ArgumentParser()
parser.add_argument("--steps", type=int, default=60)
options = parser.parse_args()
if not torch.cuda.is_available():
    sys.exit("this script needs a CUDA device")
device = torch.device("cuda", torch.cuda.current_device())
torch.cuda.set_device(device)

glctx = dr.RasterizeCudaContext(device="cuda")
corners = np.array(list(itertools.product((-0.6, 0.6), repeat=3)), dtype=np.float32)
faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
faces = np.array([[a, b, c] for a, b, c, _ in faces] + [[a, c, d] for a, _, c, d in faces])
xyz = torch.from_numpy(corners).cuda()
tri = torch.from_numpy(faces.astype(np.int32)).to("cuda")
colours = torch.as_tensor((corners + 0.6) / 1.2, dtype=torch.float32, device="cuda")
proj = torch.tensor([[2.0, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1.5, -2.5], [0, 0, 1, 0]], device=device)
noise = torch.Generator(device="cuda").manual_seed(3)


class Cube(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.size = torch.nn.Parameter(torch.tensor(0.7))
        self.colours = torch.nn.Parameter(torch.full((8, 3), 0.5))
        self.register_buffer("offset", torch.tensor([[[0.0], [0.0], [3.0]]]))

    def forward(self, turns, size, vertex_colours):
        camera = turns @ (size * xyz).T + self.offset
        clip = (proj @ torch.cat([camera, torch.ones(len(turns), 1, 8).cuda()], 1)).transpose(1, 2).contiguous()
        rast, _ = dr.rasterize(glctx, clip, tri, resolution=[24, 24])
        color, _ = dr.interpolate(vertex_colours[None], rast, tri)
        return dr.antialias(color * (rast[..., 3:] > 0), rast, clip, tri)


model = Cube().cuda()
optimizer = torch.optim.Adam(model.parameters(), lr=2e-2)
start, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
start.record()
sizes = []
for _ in range(options.steps):
    turns = torch.linalg.qr(torch.randn(4, 3, 3, generator=noise, device="cuda"))[0]
    turns = turns * torch.linalg.det(turns)[:, None, None]
    with torch.no_grad():
        target = model(turns, torch.ones((), device="cuda"), colours)
    loss = ((model(turns, model.size, model.colours) - target) ** 2).mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    sizes.append(model.size.detach().cpu().numpy())
end.record()
torch.cuda.synchronize()
colours += 1  # On a GPU, this does not change the array from which the tensor was made.
result = {
    "sizes": [float(size) for size in sizes],
    "milliseconds": start.elapsed_time(end),
    "memory": torch.cuda.max_memory_allocated(),
    "corners": corners,
}
print(f"size {result['sizes'][-1]:.3f}")
