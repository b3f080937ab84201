"""Compute the jump ratio of a run and of true images, on the same orbit around the subject of a synthetic capture.

python tools/synthetic/true_jump.py demo/scene.work/run --images 240

The jump ratio (the column `jump` of tools/quality_table.py) is the largest difference between neighbouring images of
the orbit, divided by the median difference. It is above 1 even for true images, because neighbouring images differ more
where the subject covers more pixels. Only what a run adds to the true ratio is an error of the run.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from rich.progress import track

from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.synth.figure import make_figure, pose_figure
from fourd.synth.folder import read_settings
from fourd.synth.generate import SynthSettings, gait_phase
from fourd.synth.render import render_figure
from fourd.training.evaluation.defects import jump_ratio
from fourd.training.run import load_run
from fourd.viewer.navigation.paths import orbit


@dataclass(frozen=True)
class Arguments:
    """The training run, and the number of images on the orbit."""

    run: tyro.conf.Positional[Path]
    """Folder of a training run. Its capture must have been written by fourd synth."""
    images: int = 240
    """Number of images on a full orbit at the middle frame."""


def main(arguments: Arguments) -> None:
    """Print both ratios."""
    torch.set_grad_enabled(False)
    trained = load_run(arguments.run)
    content = read_settings(trained.run.config.capture)
    if content is None or "dome" in content:
        raise UserError(f"{arguments.run}: expected a run on a capture of fourd synth (no --dome), got another capture")
    settings = SynthSettings(**{name: content[name] for name in SynthSettings.__dataclass_fields__})
    capture, layers = trained.run.capture, trained.run.config.train.layers
    frame = capture.frame_count // 2
    points = trained.frames.get(frame)
    cameras = orbit(capture.cameras, arguments.images, focus=trained.run.focus)
    figure = make_figure(settings.seed)
    parts = pose_figure(figure, gait_phase(frame, settings.frames))

    def true_image(camera: Camera) -> NDArray[np.float32]:
        black = np.zeros((camera.height, camera.width, 3))
        return render_figure(parts, camera, black, settings.gloss).rgb.astype(np.float32) / 255

    path = [*cameras, cameras[0]]
    rendered = [trained.renderer.render(points, frame, camera, layers).rgb for camera in track(path, "rendered")]
    true = [true_image(camera) for camera in track(path, "true")]
    print(f"jump: rendered {jump_ratio(rendered):.3f}, true {jump_ratio(true):.3f}")
    trained.close()


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
