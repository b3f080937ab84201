"""Fit triangles to an image through OpenGL, which computes no gradients.

The renderer is a black box for fourd.rendering.triangles.estimate_gradient: it draws triangles with OpenGL, each in one
colour, and returns the image and the index of the triangle that each pixel shows. Each step of the optimiser draws two
images.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import moderngl
import numpy as np
import torch
import tyro
from PIL import Image
from torch import Tensor

from fourd.rendering.triangles import estimate_gradient
from fourd.viewer.gl.context import offscreen_context

VERTEX_SHADER = """
#version 330
in vec2 corner;
in vec3 colour;
flat out vec3 shade;
flat out float number;
void main() {
    shade = colour;
    number = float(gl_VertexID / 3);
    gl_Position = vec4(corner, 0.0, 1.0);
}
"""
FRAGMENT_SHADER = """
#version 330
flat in vec3 shade;
flat in float number;
layout(location = 0) out vec3 image;
layout(location = 1) out float id;
void main() {
    image = shade;
    id = number;
}
"""


@dataclass(frozen=True)
class Arguments:
    picture: Path = Path("black_box.png")
    """Output image: the target, the image before the fit and the image after the fit, side by side."""
    steps: int = 600
    """Number of steps of the optimiser."""
    triangles: int = 120
    """Number of triangles that are fitted."""
    size: int = 128
    """Width and height of the images in pixels."""
    seed: int = 0
    """Seed of all random numbers."""


class TriangleRenderer:
    """Draws triangles in the order of their indices: the last one is in front.

    A triangle has 9 parameters: x and y of its three corners from -1 to 1, and red, green and blue from 0 to 1.
    """

    def __init__(self, context: moderngl.Context, count: int, size: int) -> None:
        self._buffer = context.buffer(reserve=3 * count * 5 * 4)
        program = context.program(vertex_shader=VERTEX_SHADER, fragment_shader=FRAGMENT_SHADER)
        self._array = context.vertex_array(program, [(self._buffer, "2f 3f", "corner", "colour")])
        self._textures = [context.texture((size, size), components, dtype="f4") for components in (3, 1)]
        self._target = context.framebuffer(self._textures)
        self._size = size

    def draw(self, params: Tensor) -> Tensor:
        """Draw an image (size, size, 3) of triangles with the parameters ``params`` (T, 9). Also store the index of the
        triangle that each pixel shows, for :meth:`ids`."""
        corners = params[:, :6].reshape(-1, 3, 2)
        colours = params[:, None, 6:].clamp(0, 1).expand(-1, 3, -1)
        self._buffer.write(torch.cat((corners, colours), 2).numpy().astype(np.float32).tobytes())
        self._target.use()
        # clear() sets all ids to 0, which is the id of the first triangle, so the ids are overwritten with -1.
        self._target.clear()
        self._textures[1].write(np.full((self._size, self._size), -1, np.float32).tobytes())
        self._array.render(moderngl.TRIANGLES)
        return self._read(0, 3)

    def ids(self, _: Tensor) -> Tensor:
        """Return the index (size, size) of the triangle that each pixel of the last image shows, or -1 if it shows
        none."""
        return self._read(1, 1)[..., 0].round().long()

    def _read(self, attachment: int, components: int) -> Tensor:
        values = np.frombuffer(self._textures[attachment].read(), np.float32)
        return torch.from_numpy(values.reshape(self._size, self._size, components).copy())


def target_picture(size: int) -> Tensor:
    """Return an image (size, size, 3) of a disc and a ring in front of a colour gradient."""
    y, x = torch.meshgrid(*(torch.linspace(-1, 1, size),) * 2, indexing="ij")
    picture = torch.stack((0.3 + 0.3 * x, 0.4 + 0.2 * y, 0.6 - 0.3 * x), 2)
    radius = (x**2 + y**2).sqrt()
    picture[(radius > 0.65) & (radius < 0.85)] = torch.tensor([0.95, 0.9, 0.3])
    picture[(x - 0.1) ** 2 + (y + 0.1) ** 2 < 0.12] = torch.tensor([0.9, 0.2, 0.15])
    return picture


def random_triangles(count: int, generator: torch.Generator) -> Tensor:
    """Return the parameters (count, 9) of small triangles at random places."""
    centres = 2 * torch.rand(count, 1, 2, generator=generator) - 1
    corners = centres + 0.25 * torch.randn(count, 3, 2, generator=generator)
    return torch.cat((corners.reshape(count, 6), torch.rand(count, 3, generator=generator)), 1)


def main(arguments: Arguments) -> None:
    generator = torch.Generator().manual_seed(arguments.seed)
    target = target_picture(arguments.size)
    params = random_triangles(arguments.triangles, generator)
    renderer = TriangleRenderer(offscreen_context(), arguments.triangles, arguments.size)

    def loss(image: Tensor) -> Tensor:
        return ((image - target) ** 2).sum(2)

    first = renderer.draw(params)
    # The perturbation is 1.5 pixels for corners, and 5% of the range for colours.
    epsilon = torch.tensor([3 / arguments.size] * 6 + [0.05] * 3)
    optimizer = torch.optim.Adam([params], lr=0.01)
    for _ in range(arguments.steps):
        params.grad = estimate_gradient(renderer.draw, loss, params, renderer.ids, epsilon=epsilon, generator=generator)
        optimizer.step()
    last = renderer.draw(params)
    print(f"mean squared error: {loss(first).mean():.4f} before, {loss(last).mean():.4f} after {arguments.steps} steps")
    pictures = (255 * torch.cat((target, first, last), 1).clamp(0, 1)).round().byte()
    Image.fromarray(pictures.numpy()).save(arguments.picture)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
