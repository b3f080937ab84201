"""Find the pose of a cube from one image, starting from random poses.

    python examples/triangles/pose.py --starts 20

Each start optimises a quaternion. The difference between the rendered image and the target has local minima, so the
first half of the optimisation steps is divided into trials. Before each trial, several random rotations are applied to
the best pose so far. The trial then optimises the rotated pose whose image is closest to the target. The random
rotations become smaller from trial to trial.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from common import (
    angle_deg,
    cube,
    face_colours,
    perspective,
    random_rotations,
    rigid,
    rotation_of_quaternion,
    save,
    to_clip,
)
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import avg_pool2d

from fourd.rendering.triangles import antialias, interpolate, rasterize

TRIAL_STEPS = 20
"""Number of steps of a trial in the first half of the search. Each trial optimises a randomly rotated copy of the best
pose."""

CANDIDATES = 64
"""Number of randomly rotated copies of the best pose from which each trial chooses. The copies are compared with the
target at a quarter of the image size."""


@dataclass(frozen=True)
class Arguments:
    """Options of the search."""

    starts: int = 10
    """Number of searches. Each search has its own random true pose and its own random first pose."""
    steps: int = 500
    """Steps of Adam per start."""
    size: int = 128
    """Width and height of the image in pixels, a multiple of 4."""
    seed: int = 0
    """Seed of the poses."""
    picture: Path = Path("pose.png")
    """Output image: the cube in the true, the first and the found pose of the last search."""


def main(arguments: Arguments) -> float:
    """Search for the poses. Returns the fraction of starts that end within 2 degrees of the true pose."""
    rng = np.random.default_rng(arguments.seed)
    found = []
    for start in range(arguments.starts):
        R_true, R_first = random_rotations(2, rng)
        target = render(R_true[None], arguments.size)[0]
        R_found = search(target, R_first, arguments, rng)
        error = float(angle_deg(R_true, R_found))
        found.append(error < 2)
        print(f"start {start}: {float(angle_deg(R_true, R_first)):.1f} degrees before, {error:.2f} degrees after")
    share = sum(found) / len(found)
    print(f"{sum(found)} of {len(found)} starts found the pose within 2 degrees")
    save(list(render(torch.stack([R_true, R_first, R_found]), 256)), arguments.picture)
    return share


def search(target: Tensor, R_first: Tensor, arguments: Arguments, rng: np.random.Generator) -> Tensor:
    """Optimise the pose so that the rendered cube matches ``target`` (H, W, 3). Returns the best rotation (3, 3)."""
    best_loss, best = float("inf"), quaternion_of_rotation(R_first)
    quaternion = best.clone().requires_grad_()
    optimizer = torch.optim.Adam([quaternion], lr=2e-2)
    for step in range(arguments.steps):
        remaining = 1 - step / arguments.steps
        if step % TRIAL_STEPS == 0 and remaining > 0.5:
            noise_rad = np.pi / 2 * (2 * remaining - 1) * rng.normal(size=(CANDIDATES, 3))
            noise = torch.from_numpy(Rotation.from_rotvec(noise_rad).as_matrix()).float()
            R = noise @ rotation_of_quaternion(best)
            small = avg_pool2d(target.permute(2, 0, 1), 4).permute(1, 2, 0)
            differences = (render(R, small.shape[0]) - small).square().mean(dim=(1, 2, 3))
            with torch.no_grad():
                quaternion.copy_(quaternion_of_rotation(R[differences.argmin()]))
        elif step % TRIAL_STEPS == 0:
            optimizer.param_groups[0]["lr"] = 2e-2 * remaining
        loss = (render(rotation_of_quaternion(quaternion)[None], arguments.size)[0] - target).square().mean()
        if float(loss.detach()) < best_loss:
            best_loss, best = float(loss.detach()), quaternion.detach().clone()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return rotation_of_quaternion(best)


def quaternion_of_rotation(R: Tensor) -> Tensor:
    """Return the unit quaternion (4,) of a rotation (3, 3), in the order w, x, y, z."""
    return torch.from_numpy(Rotation.from_matrix(R.numpy()).as_quat(scalar_first=True)).float()


def render(R: Tensor, size: int) -> Tensor:
    """Render the cube with the rotations ``R`` (B, 3, 3), on a black background. Returns (B, size, size, 3)."""
    xyz, tri = cube()
    colours, colour_tri = face_colours()
    pos = to_clip(perspective(0.4) @ rigid(R, (0, 0, -5.5)), xyz)
    rast, _ = rasterize(pos, tri, (size, size))
    colour, _ = interpolate(colours, rast, colour_tri)
    colour = torch.where(rast[..., 3:] > 0, colour, torch.zeros_like(colour))
    return antialias(colour, rast, pos, tri)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
