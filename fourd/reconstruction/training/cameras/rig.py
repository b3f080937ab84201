"""The current cameras of a capture: poses, intrinsics and colour corrections."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.base.cameras import Camera


@dataclass(frozen=True, eq=False)
class Rig:
    """All selected cameras of a capture.

    Attributes:
        cameras: pinhole cameras, in the capture's order.
        colours: (V, 3, 4) affine map ``M @ rgb + offset`` from the scene's colours to each camera's colours. The offset
            is the last column of each map. If None, all cameras show the scene's colours unchanged.
    """

    cameras: tuple[Camera, ...]
    colours: Tensor | None = None

    def scene_colours(self, index: int, picture: Tensor) -> Tensor:
        """Map an image (3, H, W) of camera ``index`` to the scene's colours."""
        if self.colours is None:
            return picture
        matrix, offset = self.colours[index, :, :3], self.colours[index, :, 3]
        inverse = torch.linalg.inv(matrix.double()).to(picture)
        return torch.einsum("ij,jhw->ihw", inverse, picture - offset[:, None, None].to(picture))

    def camera_colours(self, index: int, rgb: Tensor, alpha: Tensor) -> Tensor:
        """Map composited colours (H, W, 3), premultiplied by ``alpha`` (H, W), to the colours of camera ``index``."""
        return rgb if self.colours is None else recolour(self.colours[index].to(rgb), rgb, alpha)


def recolour(colours: Tensor, rgb: Tensor, alpha: Tensor) -> Tensor:
    """Apply an affine colour map to colours ``rgb`` (H, W, 3) that are premultiplied by ``alpha`` (H, W). The map
    ``colours`` (3, 4) is [M, offset], and the result is ``M @ rgb + alpha * offset``."""
    return rgb @ colours[:, :3].T + alpha[..., None] * colours[:, 3]
