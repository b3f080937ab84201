"""The option --outputs of `fourd render`: opacity, depth and normals for compositors."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.cli.help import RARE
from fourd.cli.options import option, split_names

if TYPE_CHECKING:
    from rich.console import Console

    from fourd.base.storage import Location
    from fourd.scene.outputs.channels import Channels
    from fourd.scene.playable import Playable
    from fourd.viewer.playback.prefetch import BakedFrameSource

OUTPUTS = ("rgb", "alpha", "depth", "normal")
DESCRIPTION = "outputs.json"
_RANGE = 10.0
"""Largest depth that a PNG can store, at least, as a multiple of the distance from the cameras to the focus."""


@dataclass(frozen=True)
class OutputOptions:
    """Images for compositors, each kind in a folder of its own."""

    outputs: Annotated[str | None, option("rgb,alpha,depth,normal", "the images alone")] = None
    """Kinds of images to write, separated by commas: images on black, opacity, depth, and normals in camera axes."""
    image_format: Annotated[Literal["png", "exr"], RARE] = "png"
    """Format of the --outputs: png (16 bits) or exr (32-bit floats, colours in linear light)."""
    depth_scale: Annotated[float | None, RARE, option("FLOAT", "0.001, or as the scene needs")] = None
    """World units per step of a depth in a PNG, which are 65535 at most."""


def check_outputs(options: OutputOptions) -> tuple[str, ...]:
    """Return the kinds of images that the option names; none without the option. Raises UserError."""
    names = tuple(dict.fromkeys(split_names(options.outputs) or ()))
    if options.outputs is not None and (not names or set(names) - set(OUTPUTS)):
        raise UserError(f"--outputs: expected names out of {', '.join(OUTPUTS)}, got '{options.outputs}'")
    if options.depth_scale is not None and not 0 < options.depth_scale < np.inf:
        raise UserError(f"--depth-scale: expected world units above 0, got {options.depth_scale:g}")
    if not names and (options.image_format != "png" or options.depth_scale is not None):
        raise UserError("--image-format, --depth-scale: expected --outputs with them, got none; add --outputs")
    return names


class OutputWriter:
    """Writes the images of one command.

    Args:
        source: path of the run, the scene or the meshes.
        background: colour behind ``rgb``, or None for black, on which the colours are premultiplied.
    """

    def __init__(
        self,
        options: OutputOptions,
        source: Location,
        playable: Playable,
        layers: int | None,
        background: tuple[float, float, float] | None,
        console: Console,
    ) -> None:
        from fourd.scene.meshes.playable import PlayableMeshes
        from fourd.scene.outputs.channels import ChannelPainter
        from fourd.viewer.playback.sources import open_frame_source

        self._names = check_outputs(options)
        self._suffix = f".{options.image_format}"
        self._playable, self._layers, self._background = playable, layers, background
        self._painter = ChannelPainter()
        is_mesh = isinstance(playable, PlayableMeshes)
        self._frames: BakedFrameSource | None = None if is_mesh else open_frame_source(source)
        self._last: tuple[int, Any] | None = None
        self._scale = options.depth_scale or _depth_scale(playable)
        self._is_clipped = False
        self._console = console
        if "depth" in self._names and options.image_format == "png":
            console.print(f"depth: value * {self._scale:g} world units, up to {65535 * self._scale:g}; 0 is empty")

    def write(self, folder: Path, name: str, camera: Camera, frame: int) -> None:
        """Write the images of a view to ``folder``/KIND/``name``.png or .exr. Raises OSError."""
        from fourd.viewer.output.channels import to_linear, write_channel

        channels = self._channels(camera, frame)
        images: dict[str, NDArray[np.float32]] = {"alpha": channels.alpha, "depth": channels.depth}
        images["normal"] = channels.normal
        is_float = self._suffix == ".exr"
        if "rgb" in self._names:
            behind = np.asarray(self._background or (0, 0, 0), np.float32)
            rgb = self._playable.render(camera, frame, self._layers, behind).clip(0, 1)
            images["rgb"] = to_linear(rgb, None if self._background else channels.alpha) if is_float else rgb
        if not is_float:
            covered = np.linalg.norm(channels.normal, axis=2, keepdims=True) > 0
            images["normal"] = np.where(covered, channels.normal * 0.5 + 0.5, 0)
            images["depth"] = channels.depth / np.float32(65535 * self._scale)
            self._warn(float(channels.depth.max()))
        for kind in self._names:
            write_channel(folder / kind / f"{name}{self._suffix}", images[kind])

    def describe(self, folder: Path) -> None:
        """Write what the values of the images mean to a JSON file in ``folder``."""
        from fourd.base.files import write_text_atomically
        from fourd.scene.playable import metres_per_unit

        is_float = self._suffix == ".exr"
        colours = "linear light (sRGB primaries)" if is_float else "sRGB"
        content: dict[str, Any] = {
            "rgb": {"colours": colours, "background": list(self._background or (0, 0, 0))},
            "alpha": {"range": [0, 1]},
            "depth": {
                "meaning": "camera depth z in world units; 0 where nothing is",
                "world_units_per_step": None if is_float else self._scale,
                "metres_per_world_unit": metres_per_unit(self._playable),
            },
            "normal": {
                "axes": "camera: x right, y up, z towards the camera",
                "coding": "value" if is_float else "0.5 * value + 0.5; (0, 0, 0) where nothing is",
            },
        }
        kept = {"format": self._suffix[1:], **{kind: content[kind] for kind in self._names}}
        write_text_atomically(folder / DESCRIPTION, json.dumps(kept, indent=1))

    def _channels(self, camera: Camera, frame: int) -> Channels:
        from fourd.scene.meshes.playable import PlayableMeshes
        from fourd.scene.outputs.channels import mesh_channels

        if isinstance(self._playable, PlayableMeshes):
            return mesh_channels(self._playable.draw(camera, frame))
        assert self._frames is not None
        if self._last is None or self._last[0] != frame:
            self._last = (frame, self._frames.read(frame))
        return self._painter.draw(self._last[1], camera, self._frames.manifest, self._layers)

    def _warn(self, depth: float) -> None:
        if "depth" in self._names and depth > 65535 * self._scale and not self._is_clipped:
            self._is_clipped = True
            self._console.print(
                f"depth: {depth:.4g} is more than {65535 * self._scale:g} and is clamped in the PNG; choose a larger "
                "--depth-scale or --image-format exr",
                soft_wrap=True,
            )


def _depth_scale(playable: Playable) -> float:
    """Return 0.001 or, for scenes of another size, 1, 2 or 5 times a power of ten."""
    centres = [camera.centre for camera in playable.views.values()]
    focus = np.asarray(playable.focus)
    distance = max((float(np.linalg.norm(centre - focus)) for centre in centres), default=1.0)
    least = _RANGE * distance / 65535
    if least <= 0.001 and distance > 0.3:
        return 0.001
    power = 10.0 ** np.floor(np.log10(max(least, 1e-12)))
    return float(f"{next(step * power for step in (1, 2, 5, 10) if step * power >= least):.6g}")
