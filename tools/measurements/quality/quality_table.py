"""Measure the image quality of trained runs: the scores of held-out and training views, the fractions of the error at
the subject's contour and elsewhere, specks (tiny regions with a large error), jumps (sudden changes between
neighbouring viewpoints) and flicker.

A jump is above 1 even for true images, because neighbouring images differ more where the subject covers more pixels.
For captures of fourd synth, the jump of true images on the same orbit is therefore given, too: only what a run adds to
it is an error of the run.

python tools/measurements/quality/quality_table.py RUN [RUN ...]
python tools/measurements/quality/quality_table.py RUN --orbit 240 --pictures pictures/ --json quality.json
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import flip_evaluator
import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.reconstruction.training.evaluation.defects import (
    contour_errors,
    flicker,
    jump_ratio,
    silhouette_errors,
    speck_pixels,
)
from fourd.reconstruction.training.evaluation.metrics import mask_box
from fourd.reconstruction.training.evaluation.render import RenderedView
from fourd.reconstruction.training.evaluation.scores import BOX_MARGIN_PX, score_view
from fourd.reconstruction.training.run import TrainedRun, load_run
from fourd.recording.synth.figure import make_figure, pose_figure
from fourd.recording.synth.folder import read_settings
from fourd.recording.synth.generate import SynthSettings, gait_phase
from fourd.recording.synth.render import render_figure
from fourd.viewer.navigation.paths import orbit
from tools.measurements.tables import table

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Arguments:
    """The runs, and the quantities to measure in addition to the scores."""

    runs: tyro.conf.Positional[list[Path]]
    """Folders of runs that were trained with --test-views."""
    frames: int = 6
    """Number of frames to measure, spread evenly over the run's frames, or 0 for all frames."""
    orbit: int = 0
    """Number of images on a full orbit around the subject at the middle frame. The column `jump` is the largest
    difference between neighbouring images, divided by the median difference, and in brackets that of the true images
    of a synthetic subject. With 0 images, `jump` is not measured."""
    pictures: Path | None = None
    """Folder for images that show, for the middle frame of each held-out view, the rendered image, the true image and
    the error."""
    json: Path | None = None
    """JSON file for all measured values."""


@dataclass(frozen=True)
class ViewQuality:
    """Measured values of one image, inside the matte's bounding box. ``specks`` is the fraction of the box's pixels
    that belong to small regions with a large error."""

    psnr: float
    ssim: float | None
    flip: float
    specks: float
    contour: float
    near: float
    inside: float
    outside: float
    excess: float
    missing: float


@dataclass(frozen=True)
class RunQuality:
    """The values of a run, averaged over its views. They are the columns of the table in :func:`markdown`.

    ``radii`` are quantiles of the points' radii over all measured frames, in multiples of the point spacing.
    """

    unseen: ViewQuality
    seen_psnr: float
    flicker: float
    jump: float | None
    true_jump: float | None
    radii: tuple[float, float, float]


@torch.no_grad()
def main(arguments: Arguments) -> int:
    """Print a Markdown table with a row for each run."""
    results = {}
    try:
        for folder in arguments.runs:
            trained = load_run(folder)
            if not trained.run.test:
                raise UserError(f"{folder}: expected held-out views, got none; train with --test-views")
            results[str(folder)] = measure_run(trained, arguments)
            if arguments.pictures is not None:
                write_pictures(trained, arguments.pictures / folder.name)
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    print(markdown(results))
    if arguments.json is not None:
        content = {name: asdict(result) for name, result in results.items()}
        write_text_atomically(arguments.json, json.dumps(content, indent=1) + "\n")
    return 0


def measure_run(trained: TrainedRun, arguments: Arguments) -> RunQuality:
    """Measure the image quality of a run. Evenly spaced frames are measured; ``arguments.frames`` is their number, or 0
    for all frames."""
    count = trained.run.capture.frame_count
    frames = sorted(set(np.linspace(0, count - 1, arguments.frames or count).round().astype(int).tolist()))
    console = Console(stderr=True)
    jump, true_jump = measure_jumps(trained, arguments.orbit, console) if arguments.orbit else (None, None)
    jobs = [(frame, view) for frame in frames for view in trained.run.test]
    unseen = [measure_view(trained, *job) for job in track(jobs, "unseen views", console=console)]
    jobs = [(frame, view) for frame in frames for view in trained.run.training]
    seen = [measure_view(trained, *job).psnr for job in track(jobs, "seen views", console=console)]
    return RunQuality(
        unseen=mean_of(unseen),
        seen_psnr=statistics.mean(seen),
        flicker=statistics.mean(measure_flicker(trained, view) for view in trained.run.test),
        jump=jump,
        true_jump=true_jump,
        radii=radius_quantiles(trained, frames),
    )


def render(trained: TrainedRun, frame: int, view: int) -> tuple[RenderedView, Image, NDArray[np.uint8]]:
    """Return the rendered image, the true image and the matte of a view. The renderer does not use the view itself as a
    source view."""
    capture, layers = trained.run.capture, trained.run.config.train.layers
    points = trained.frames.get(frame)
    picture = trained.renderer.render(points, frame, capture.cameras[view], layers, exclude=view)
    matte = capture.mask(view, frame)
    truth = capture.image(view, frame).astype(np.float32) / 255
    if trained.run.config.train.scene == "object":
        truth *= matte[..., None].astype(np.float32) / 255
    return picture, truth, matte


def measure_view(trained: TrainedRun, frame: int, view: int) -> ViewQuality:
    """Measure one image."""
    rendered, truth, matte = render(trained, frame, view)
    image, boxed = score_view(rendered.rgb, truth, matte, None)
    scores = boxed or image
    box = mask_box(matte, BOX_MARGIN_PX) or (0, matte.shape[0], 0, matte.shape[1])
    inside = (slice(box[0], box[1]), slice(box[2], box[3]))
    picture, alpha, truth, matte = rendered.rgb[inside], rendered.foreground[inside], truth[inside], matte[inside]
    _, flip, _ = flip_evaluator.evaluate(truth, picture, "LDR", applyMagma=False)
    specks = float(speck_pixels(picture, truth).mean())
    places = asdict(contour_errors(picture, truth, matte)) | asdict(silhouette_errors(picture, truth, alpha, matte))
    return ViewQuality(scores.psnr, scores.ssim, flip, specks, **places)


def measure_flicker(trained: TrainedRun, view: int, frames: int = 8) -> float:
    """Return the flicker of a held-out view over at most ``frames`` successive frames around the run's middle frame.

    The change of a pixel is its difference between two successive images. The flicker is the mean absolute difference
    between the changes in the rendered images and the changes of the same pixels in the true images, divided by the
    mean absolute change in the true images. For a single frame, the result is 0.
    """
    first = max(0, (trained.run.capture.frame_count - frames) // 2)
    shown = range(first, min(first + frames, trained.run.capture.frame_count))
    if len(shown) < 2:
        return 0.0
    pairs = [render(trained, frame, view)[:2] for frame in shown]
    truths = [truth for _, truth in pairs]
    changes = flicker(truths, [truths[0]] * len(truths))
    return flicker([picture.rgb for picture, _ in pairs], truths) / max(changes, 1e-12)


def measure_jumps(trained: TrainedRun, steps: int, console: Console) -> tuple[float, float | None]:
    """Render ``steps`` images of a full orbit at the middle frame. Return the largest difference between neighbouring
    images, divided by the median difference, and the same for true images if the subject is that of fourd synth."""
    capture = trained.run.capture
    frame = capture.frame_count // 2
    points, layers = trained.frames.get(frame), trained.run.config.train.layers
    cameras = orbit(capture.cameras, steps, focus=trained.run.focus)
    path = [*cameras, cameras[0]]
    tracked = track(path, "orbit", console=console)
    jump = jump_ratio([trained.renderer.render(points, frame, camera, layers).rgb for camera in tracked])
    content = read_settings(trained.run.config.capture)
    if content is None or "dome" in content or "rig" in content:
        return jump, None
    settings = SynthSettings(**{name: content[name] for name in SynthSettings.__dataclass_fields__})
    parts = pose_figure(make_figure(settings.seed), gait_phase(frame, settings.frames))

    def true_image(camera: Camera) -> Image:
        black = np.zeros((camera.height, camera.width, 3))
        return render_figure(parts, camera, black, settings.gloss).rgb.astype(np.float32) / 255

    return jump, jump_ratio([true_image(camera) for camera in track(path, "true orbit", console=console)])


def radius_quantiles(trained: TrainedRun, frames: Sequence[int]) -> tuple[float, float, float]:
    """Return the median, the 90% quantile and the 99% quantile of the points' radii, in multiples of the point
    spacing."""
    ratios = torch.cat([points.radius / points.spacing for points in map(trained.frames.get, frames)]).numpy()
    median, most, nearly_all = np.quantile(ratios, [0.5, 0.9, 0.99])
    return float(median), float(most), float(nearly_all)


def mean_of(views: Sequence[ViewQuality]) -> ViewQuality:
    """Average each measured value over the images. PSNR is averaged in dB."""
    fields: dict[str, Any] = {}
    for name in ViewQuality.__dataclass_fields__:
        values = [getattr(view, name) for view in views]
        fields[name] = None if None in values else statistics.mean(values)
    return ViewQuality(**fields)


def markdown(results: dict[str, RunQuality]) -> str:
    """Return the table.

    Each column from "contour" to "missing" stands for one class of pixels inside the matte's bounding box, such as the
    pixels near the contour. It shows which fraction of the box's squared error falls on this class, averaged over the
    held-out views.
    """
    heads = ["run", "unseen dB", "SSIM", "FLIP", "seen dB", "contour", "near", "inside", "outside", "excess", "missing"]
    heads += ["specks, per 10,000 pixels", "flicker / true change", "jump", "radii p50 / p90 / p99"]
    return table(heads, rows(results))


def rows(results: dict[str, RunQuality]) -> Iterator[list[str]]:
    """Yield the table's rows."""
    for name, result in results.items():
        unseen = result.unseen
        cells = [name, f"{unseen.psnr:.2f}", "-" if unseen.ssim is None else f"{unseen.ssim:.4f}", f"{unseen.flip:.4f}"]
        cells += [f"{result.seen_psnr:.2f}"]
        places = (unseen.contour, unseen.near, unseen.inside, unseen.outside, unseen.excess, unseen.missing)
        cells += [f"{share:.0%}" for share in places]
        cells += [f"{unseen.specks * 1e4:.1f}", f"{result.flicker:.2f}"]
        true_jump = "" if result.true_jump is None else f" ({result.true_jump:.2f})"
        cells += ["-" if result.jump is None else f"{result.jump:.2f}{true_jump}"]
        cells += [" / ".join(f"{radius:.2f}" for radius in result.radii)]
        yield cells


def write_pictures(trained: TrainedRun, folder: Path) -> None:
    """For each held-out view at the middle frame, write the rendered image, the true image and the error side by
    side."""
    folder.mkdir(parents=True, exist_ok=True)
    frame = trained.run.capture.frame_count // 2
    for view in trained.run.test:
        rendered, truth, _ = render(trained, frame, view)
        picture = rendered.rgb
        sheet = np.concatenate([picture, truth, np.abs(picture - truth) * 3], axis=1).clip(0, 1)
        rgb = (sheet * 255 + 0.5).astype(np.uint8)
        cv2.imwrite(str(folder / f"{trained.run.capture.names[view]}.png"), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments, description=__doc__)))
