"""The cameras of a capture as they are known now: their poses and lenses, and how their colours differ."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.cameras import Camera


@dataclass(frozen=True, eq=False)
class Rig:
    """All cameras of a capture's selection.

    Attributes:
        cameras: pinholes, in the capture's order.
        colours: (V, 3, 4) what a camera makes of the scene's colours, ``picture = M rgb + offset`` with the offset
            as the last column; None where all make the same.
    """

    cameras: tuple[Camera, ...]
    colours: Tensor | None = None

    def scene_colours(self, index: int, picture: Tensor) -> Tensor:
        """A camera's picture (3, H, W) in the scene's colours."""
        if self.colours is None:
            return picture
        matrix, offset = self.colours[index, :, :3], self.colours[index, :, 3]
        back = torch.linalg.inv(matrix.double()).to(picture)
        return torch.einsum("ij,jhw->ihw", back, picture - offset[:, None, None].to(picture))

    def camera_colours(self, index: int, rgb: Tensor, alpha: Tensor) -> Tensor:
        """What a camera makes of composited colours (H, W, 3), where ``alpha`` (H, W) of them is there."""
        return rgb if self.colours is None else recoloured(self.colours[index].to(rgb), rgb, alpha)


def recoloured(colours: Tensor, rgb: Tensor, alpha: Tensor) -> Tensor:
    """``M rgb + alpha offset`` of (H, W, 3) colours that are premultiplied by ``alpha`` (H, W); ``colours`` (3, 4)."""
    return rgb @ colours[:, :3].T + alpha[..., None] * colours[:, 3]
