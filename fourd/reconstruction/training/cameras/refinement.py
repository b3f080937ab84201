"""Camera corrections that are learnt during training.

The renderers treat cameras as constants: they compute no gradient with respect to the camera parameters. A camera
correction instead gets its gradient through the positions of the rendered points. Each position is replaced by a
differentiable function of the correction. The value of this function is the unchanged position, and its derivative is
the motion of the point relative to the camera when the correction changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from fourd.base.cameras import Camera
from fourd.reconstruction.training.cameras.rig import Rig, recolour
from fourd.reconstruction.training.config import RefineConfig
from fourd.reconstruction.training.rendering import RenderablePoints

ROTATION, TRANSLATION = slice(0, 3), slice(3, 6)
IDENTITY = torch.eye(3, 4)


@dataclass(frozen=True)
class _GivenPose:
    """A camera before its correction: the pose R (3, 3) and T (3,) in float64, and the camera's distance from the
    scene's centre."""

    rotation: Tensor
    translation: Tensor
    distance: float


class Refinement(nn.Module):
    """Pose, focal and colour corrections of each training camera. All corrections are initially zero.

    A pose correction consists of a rotation vector in radians and a translation along the camera's axes. The
    translation is stored as a fraction of the camera's distance from the scene's centre. A focal correction is the
    logarithm of the factor that scales the focal length. A colour correction is the difference between an affine colour
    map and the identity. Each camera has separate parameter tensors, so that a step on one camera leaves the optimizer
    state of the others unchanged. Even if the scene is trained on a GPU, the corrections stay on the CPU, because
    cameras are computed there.
    """

    def __init__(
        self,
        config: RefineConfig,
        given: Sequence[Camera],
        training: Sequence[int],
        focus: NDArray[np.float64],
        colours: Tensor | None = None,
    ) -> None:
        """Create corrections that leave every camera unchanged.

        Args:
            config: which quantities are corrected, and their standard deviations and learning rates.
            given: all cameras of the capture, before correction.
            training: indices of the cameras that are corrected.
            focus: (3,) the scene's centre in world units.
            colours: (V, 3, 4) measured colour maps of all cameras, to which the learnt corrections are added. If None,
                the maps are the identity.
        """
        super().__init__()
        self.config = config
        self.given = tuple(given)
        self.places = {index: place for place, index in enumerate(training)}
        count = len(training)
        self.poses = nn.ParameterList(nn.Parameter(torch.zeros(6)) for _ in range(count if config.poses else 0))
        self.zooms = nn.ParameterList(nn.Parameter(torch.zeros(1)) for _ in range(count if config.focal else 0))
        self.tints = nn.ParameterList(nn.Parameter(torch.zeros(3, 4)) for _ in range(count if config.colours else 0))
        self.colours = IDENTITY.repeat(len(given), 1, 1) if colours is None else colours
        self._given_poses = [
            _GivenPose(
                torch.from_numpy(camera.rotation.copy()),
                torch.from_numpy(camera.translation.copy()),
                float(np.linalg.norm(camera.centre - focus)),
            )
            for camera in given
        ]

    def parameter_groups(self) -> list[dict[str, object]]:
        """Return the parameter groups with their learning rates, for the optimizer."""
        config = self.config
        rates = (
            (self.poses, config.pose_rate),
            (self.zooms, config.focal_rate),
            (self.tints, config.colour_rate),
        )
        return [{"params": list(each), "lr": rate, "base": rate} for each, rate in rates if len(each)]

    @torch.no_grad()
    def rig(self) -> Rig:
        """Return all cameras, with the current corrections applied."""
        cameras = list(self.given)
        for index in self.places if self.config.cameras else ():
            cameras[index] = self._corrected_camera(index)
        colours = None
        if self.config.colours:
            colours = self.colours.clone()
            for index in self.places:
                colours[index] = self._colour_map(index)
        return Rig(tuple(cameras), colours)

    def attach_camera_gradient(self, clouds: Sequence[RenderablePoints], index: int) -> list[RenderablePoints]:
        """Make the positions of the points differentiable functions of the correction of camera ``index``, without
        changing their values. The gradient of a rendered image then reaches the camera's correction through the
        points."""
        if not self.config.cameras:
            return list(clouds)
        return [self._attach(cloud, index) for cloud in clouds]

    def recolour(self, rgb: Tensor, alpha: Tensor, index: int) -> Tensor:
        """Map composited colours (H, W, 3), premultiplied by ``alpha`` (H, W), to the colours of camera ``index``."""
        return recolour(self._colour_map(index).to(rgb), rgb, alpha) if self.config.colours else rgb

    def penalty(self, index: int) -> Tensor:
        """Compute the sum of (correction / standard deviation)^2 over all corrections of a camera, as a scalar."""
        place, config = self.places[index], self.config
        total = torch.zeros(())
        if len(self.poses):
            pose = self.poses[place]
            total = total + (pose[ROTATION] / np.radians(config.rotation_deg)).square().sum()
            total = total + (pose[TRANSLATION] / config.position).square().sum()
        if len(self.zooms):
            total = total + (self.zooms[place] / config.focal_spread).square().sum()
        if len(self.tints):
            total = total + (self.tints[place] / config.colour_spread).square().sum()
        return total

    def _corrected_pose(self, index: int) -> tuple[Tensor, Tensor]:
        """Compute the corrected R (3, 3) and T (3,) of a camera, as float64 tensors that are differentiable with
        respect to its correction."""
        given = self._given_poses[index]
        if not len(self.poses):
            return given.rotation, given.translation
        pose = self.poses[self.places[index]].double()
        rotation = torch.linalg.matrix_exp(_cross_product_matrix(pose[ROTATION]))
        return rotation @ given.rotation, rotation @ given.translation + given.distance * pose[TRANSLATION]

    def _corrected_camera(self, index: int) -> Camera:
        rotation, translation = self._corrected_pose(index)
        camera = self.given[index]
        intrinsics = camera.intrinsics.copy()
        if len(self.zooms):
            intrinsics[:2, :2] *= float(self.zooms[self.places[index]].double().exp())
        return replace(camera, intrinsics=intrinsics, rotation=rotation.numpy(), translation=translation.numpy())

    def _attach(self, cloud: RenderablePoints, index: int) -> RenderablePoints:
        xyz, radius = cloud.xyz, cloud.radius
        rotation, translation = (value.to(xyz) for value in self._corrected_pose(index))
        in_camera = xyz.detach() @ rotation.T + translation
        if len(self.zooms):
            zoom = self.zooms[self.places[index]].to(xyz)
            factor = (zoom - zoom.detach()).exp()
            in_camera = torch.cat([in_camera[:, :2] * factor, in_camera[:, 2:]], dim=1)
            radius = radius * factor
        return replace(cloud, xyz=xyz + (in_camera - in_camera.detach()) @ rotation.detach(), radius=radius)

    def _colour_map(self, index: int) -> Tensor:
        """Compute a camera's affine colour map (3, 4). The mean of the learnt corrections of all training cameras is
        kept at zero, because a colour change that all cameras share belongs to the scene."""
        mean = torch.stack([tint.detach() for tint in self.tints]).mean(dim=0)
        return self.colours[index] + self.tints[self.places[index]] - mean


def _cross_product_matrix(vector: Tensor) -> Tensor:
    """Return the (3, 3) matrix M of the cross product with ``vector`` v: M w = v x w for all w."""
    x, y, z = vector
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
