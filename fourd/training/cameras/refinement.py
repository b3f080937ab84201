"""Corrections of cameras that are learnt with everything else.

The renderers give no gradient to cameras. Their numbers are given to them corrected, as constants; the gradient comes
by the points: these are moved by a transform that is none in value, but whose derivative is that of moving the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from fourd.cameras import Camera
from fourd.training.cameras.rig import Rig, recoloured
from fourd.training.config import RefineConfig
from fourd.training.rendering import Part

TURN, MOVE = slice(0, 3), slice(3, 6)
IDENTITY = torch.eye(3, 4)


@dataclass(frozen=True)
class _Base:
    """A camera before its learnt correction: R (3, 3) and T (3,), float64; its distance from the scene's centre."""

    rotation: Tensor
    translation: Tensor
    distance: float


class Refinement(nn.Module):
    """Per camera a pose (a rotation vector about its centre, and a move in its frame as a share of its distance),
    a logarithm of zoom and an affine change of colour: all zero at first. One parameter for each, so that cameras
    that a step does not look through keep their optimiser's state.
    """

    def __init__(
        self, config: RefineConfig, given: Sequence[Camera], training: Sequence[int], focus: NDArray[np.float64]
    ) -> None:
        """``given`` are all cameras of the capture; ``training`` the indices of those that are corrected."""
        super().__init__()
        self.config = config
        self.given = tuple(given)
        self.places = {index: place for place, index in enumerate(training)}
        count = len(training)
        self.poses = nn.ParameterList(nn.Parameter(torch.zeros(6)) for _ in range(count if config.poses else 0))
        self.zooms = nn.ParameterList(nn.Parameter(torch.zeros(1)) for _ in range(count if config.focal else 0))
        self.tints = nn.ParameterList(nn.Parameter(torch.zeros(3, 4)) for _ in range(count if config.colours else 0))
        self._bases = [
            _Base(
                torch.from_numpy(camera.rotation.copy()),
                torch.from_numpy(camera.translation.copy()),
                float(np.linalg.norm(camera.centre - focus)),
            )
            for camera in given
        ]

    def groups(self) -> list[dict[str, object]]:
        """Parameter groups for the optimiser, with their rates."""
        config = self.config
        rates = (
            (self.poses, config.pose_rate),
            (self.zooms, config.focal_rate),
            (self.tints, config.colour_rate),
        )
        return [{"params": list(each), "lr": rate, "base": rate} for each, rate in rates if len(each)]

    @torch.no_grad()
    def rig(self) -> Rig:
        """The cameras as corrected now."""
        cameras = list(self.given)
        for index in self.places if self.config.cameras else ():
            cameras[index] = self._camera(index)
        colours = None
        if self.config.colours:
            colours = IDENTITY.repeat(len(cameras), 1, 1)
            for index in self.places:
                colours[index] = self._colours(index)
        return Rig(tuple(cameras), colours)

    def seen(self, parts: Sequence[Part], index: int) -> list[Part]:
        """The same parts, of which the gradient also reaches the camera ``index`` that looks at them."""
        if not self.config.cameras:
            return list(parts)
        return [self._seen(part, index) for part in parts]

    def recoloured(self, rgb: Tensor, alpha: Tensor, index: int) -> Tensor:
        """Composited colours (H, W, 3) as the camera ``index`` shows them."""
        return recoloured(self._colours(index), rgb, alpha) if self.config.colours else rgb

    def penalty(self, index: int) -> Tensor:
        """How far a camera's corrections go, in squares of the standard deviations, times the config's weight."""
        place, config = self.places[index], self.config
        total = torch.zeros(())
        if len(self.poses):
            pose = self.poses[place]
            total = total + (pose[TURN] / np.radians(config.rotation_deg)).square().sum()
            total = total + (pose[MOVE] / config.position).square().sum()
        if len(self.zooms):
            total = total + (self.zooms[place] / config.focal_spread).square().sum()
        if len(self.tints):
            total = total + (self.tints[place] / config.colour_spread).square().sum()
        return config.weight * total

    def _pose(self, index: int) -> tuple[Tensor, Tensor]:
        """R (3, 3) and T (3,) of a camera, float64; differentiable."""
        base = self._bases[index]
        if not len(self.poses):
            return base.rotation, base.translation
        pose = self.poses[self.places[index]].double()
        turn = torch.linalg.matrix_exp(_cross(pose[TURN]))
        return turn @ base.rotation, turn @ base.translation + base.distance * pose[MOVE]

    def _camera(self, index: int) -> Camera:
        rotation, translation = self._pose(index)
        camera = self.given[index]
        intrinsics = camera.intrinsics.copy()
        if len(self.zooms):
            intrinsics[:2, :2] *= float(self.zooms[self.places[index]].double().exp())
        return replace(camera, intrinsics=intrinsics, rotation=rotation.numpy(), translation=translation.numpy())

    def _seen(self, part: Part, index: int) -> Part:
        xyz, radius = part.xyz, part.radius
        rotation, translation = (value.to(xyz) for value in self._pose(index))
        in_camera = xyz.detach() @ rotation.T + translation
        if len(self.zooms):
            zoom = self.zooms[self.places[index]].to(xyz)
            relative = (zoom - zoom.detach()).exp()
            in_camera = torch.cat([in_camera[:, :2] * relative, in_camera[:, 2:]], dim=1)
            radius = radius * relative
        return replace(part, xyz=xyz + (in_camera - in_camera.detach()) @ rotation.detach(), radius=radius)

    def _colours(self, index: int) -> Tensor:
        """(3, 4) of a camera; the mean over the cameras is the identity, whatever each would like."""
        mean = torch.stack([tint.detach() for tint in self.tints]).mean(dim=0)
        return IDENTITY + self.tints[self.places[index]] - mean


def _cross(vector: Tensor) -> Tensor:
    """(3, 3) that multiplies as the cross product with ``vector`` does."""
    x, y, z = vector
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
