"""Evaluate a run on its held-out views."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.progress import Terminal, Tracker
from fourd.cli.options import LpipsWeights, RunPath, chosen_views, option
from fourd.cli.outputs import READS, WRITES_JSON
from fourd.reconstruction.training.run_layout import segment_folder

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from fourd.reconstruction.training.evaluation.camera_fitting import FittedView
    from fourd.reconstruction.training.evaluation.render import RenderedView
    from fourd.reconstruction.training.evaluation.scores import Evaluation
    from fourd.reconstruction.training.run import TrainedRun
    from fourd.reconstruction.training.segments.segmented_run import SegmentedRun
    from fourd.recording.capture import Capture

PLATES_HELP = (
    "Folder of images CAM.png that show the scene without the subject. These images are compared with the rendered "
    "background of a full scene."
)


@dataclass(frozen=True)
class Arguments:
    """The command prints mean PSNR, SSIM and LPIPS, for whole images and inside the matte's bounding box. For a scene
    with background, it also prints the PSNR over the pixels that show the subject or a part of the background that is
    visible in at least one training view."""

    run: RunPath
    """Run folder."""
    json: Annotated[Path | None, WRITES_JSON, option("FILE", "none")] = None
    """Write the scores of every image to this file as JSON."""
    views: Annotated[str | None, option("NAME,NAME", "the held-out views")] = None
    """Names of the cameras to evaluate, separated by commas."""
    exclude_views: Annotated[str | None, option("NAME,NAME", "none")] = None
    """Names of held-out views that are not evaluated, separated by commas."""
    scene: Annotated[Path | None, READS, option("SCENE.4dv", "none")] = None
    """Evaluate this scene file, which was exported from the run, instead of the run's model."""
    plates: Annotated[Path | None, READS, option("DIR", "none", PLATES_HELP)] = None
    refine_test: bool = False
    """Before evaluation, fit the pose of each evaluated camera to its images, as in BARF. The scene is not changed."""
    refine_test_colours: bool = False
    """With --refine-test, also fit an affine colour correction of each evaluated camera to its images."""
    lpips_weights: LpipsWeights = None


def run(arguments: Arguments) -> None:
    """Render every held-out image, compare it with the captured image, and print the mean scores."""
    from rich.progress import track

    from fourd.reconstruction.training.evaluation.covisibility import covisible_psnr
    from fourd.reconstruction.training.evaluation.scores import ViewScores, score_view, summarize
    from fourd.reconstruction.training.losses.lpips import load_lpips
    from fourd.reconstruction.training.segments.segmented_run import open_trained

    console = Terminal(stderr=True)
    trained = open_trained(arguments.run)
    indices = _evaluated_views(trained, arguments)
    lpips = load_lpips(arguments.lpips_weights)
    if lpips is None:
        console.print("LPIPS: no weights found, so LPIPS is not measured; name the weights with --lpips-weights")
    pictures = []
    capture = trained.run.capture
    fitted = _fit_cameras(trained, indices, arguments, console)
    exported = None
    if arguments.scene is not None:
        from fourd.scene import open_scene

        exported = open_scene(arguments.scene)
    whole = (trained.run.config.train.scene if exported is None else exported.manifest.kind) == "full"
    masks = _covisible_masks(trained, indices, fitted, console)
    for frame in track(range(capture.frame_count), description="eval", console=console):
        for index in indices:
            camera = fitted[index].camera if index in fitted else capture.cameras[index]
            if exported is not None:
                rgb = exported.render(camera, frame).rgb.clip(0, 1)
            else:
                layers = trained.run.config.train.layers
                picture = trained.render(frame, camera, layers, exclude=index)
                rgb = _display_colours(trained, index, fitted, picture)
            matte = _matte(capture, index, frame, whole)
            truth = _truth(capture.image(index, frame), None if whole else matte)
            image, box = score_view(rgb, truth, matte, lpips)
            seen = covisible_psnr(rgb, truth, matte, masks[index]) if index in masks else None
            pictures.append(ViewScores(capture.names[index], capture.frame_numbers[frame], image, box, seen))
    evaluation = summarize(pictures)
    backgrounds = {} if arguments.plates is None else _backgrounds(trained, indices, arguments.plates, fitted)
    _print(evaluation, trained, backgrounds)
    for line in _matte_notes(capture, indices):
        Terminal().print(line, soft_wrap=True)
    for index, view in fitted.items():
        note = f"rotated by {view.degrees:.3f} degrees, moved by {view.distance:.4f} world units"
        colours = ", colours fitted" if view.colours is not None else ""
        line = f"{capture.names[index]}: fitted to its own images before evaluation: {note}{colours}"
        Terminal().print(line, soft_wrap=True)
    if arguments.json is not None:
        _write_json(arguments.json, arguments.run, trained, evaluation, backgrounds, fitted)


def _write_json(
    path: Path,
    run_folder: Path,
    trained: TrainedRun | SegmentedRun,
    evaluation: Evaluation,
    backgrounds: dict[str, float],
    fitted: dict[int, FittedView],
) -> None:
    content = {"run": str(run_folder), "step": trained.step, **evaluation.to_json()}
    if backgrounds:
        content["background"] = backgrounds
    if fitted:
        content["fitted_to_own_pictures"] = {
            trained.run.capture.names[index]: {
                "degrees": view.degrees,
                "distance": view.distance,
                "colours": None if view.colours is None else view.colours.tolist(),
            }
            for index, view in fitted.items()
        }
    write_text_atomically(path, json.dumps(content, indent=1) + "\n")


def _fit_cameras(
    trained: TrainedRun | SegmentedRun, indices: list[int], arguments: Arguments, console: Console
) -> dict[int, FittedView]:
    """Fit each evaluated camera to its own images.

    Returns the fitted cameras, keyed by camera index. The result is empty without --refine-test.
    """

    from rich.progress import track

    from fourd.reconstruction.training.evaluation.camera_fitting import fit_test_camera
    from fourd.reconstruction.training.segments.segmented_run import SegmentedRun

    if arguments.refine_test_colours and not arguments.refine_test:
        raise UserError(
            "--refine-test-colours: expected also --refine-test, got only --refine-test-colours; add --refine-test"
        )
    if arguments.refine_test_colours and arguments.scene is not None:
        raise UserError("--refine-test-colours: expected no --scene, got both options; remove one of them")
    if not arguments.refine_test:
        return {}
    if isinstance(trained, SegmentedRun):
        raise UserError(
            f"--refine-test: expected a run with one model, got the segments of {trained.run.folder}; leave "
            f"--refine-test out, or name one segment, such as {segment_folder(trained.run.folder, 0)}"
        )
    layers = trained.run.config.train.layers
    return {
        index: fit_test_camera(trained.renderer, trained.frames, index, layers, colours=arguments.refine_test_colours)
        for index in track(indices, description="fitting cameras", console=console)
    }


def _covisible_masks(
    trained: TrainedRun | SegmentedRun, indices: list[int], fitted: dict[int, FittedView], console: Console
) -> dict[int, NDArray[np.bool_]]:
    """Return, for each evaluated camera of a scene with background, the mask (H, W) of the pixels at which the surface
    of the background is visible in a training view. For a scene without background, the result is empty."""
    from fourd.reconstruction.training.evaluation.covisibility import covisible_masks
    from fourd.reconstruction.training.segments.segmented_run import SegmentedRun

    if isinstance(trained, SegmentedRun) or trained.renderer.background is None:
        return {}
    cameras = {i: fitted[i].camera if i in fitted else trained.run.capture.cameras[i] for i in indices}
    return covisible_masks(trained.renderer, cameras, trained.run.config.train.layers, Tracker(console).track)


def _display_colours(
    trained: TrainedRun | SegmentedRun, index: int, fitted: dict[int, FittedView], picture: RenderedView
) -> NDArray[np.float32]:
    """Apply the colour correction of camera ``index`` to a rendered image, if the camera has one. Returns (H, W, 3)."""
    import torch

    if index in fitted and fitted[index].colours is not None:
        return fitted[index].recolour(picture.rgb, picture.alpha).clip(0, 1)
    rgb, alpha = torch.from_numpy(picture.rgb), torch.from_numpy(picture.alpha)
    return trained.rig.camera_colours(index, rgb, alpha).clamp(0, 1).numpy()


def _matte(capture: Capture, index: int, frame: int, whole: bool) -> NDArray[np.uint8]:
    """Return the matte (H, W) of an evaluated view. In a scene with background, a camera without mattes has an
    empty matte, so that only the whole image is scored."""
    import numpy as np

    if index in capture.masked or not whole:
        return capture.mask(index, frame)
    return np.zeros((capture.cameras[index].height, capture.cameras[index].width), np.uint8)


def _matte_notes(capture: Capture, indices: list[int]) -> list[str]:
    """Return one line each for evaluated cameras without mattes, and for those whose mattes come from other masks."""
    lines, masked, generated = [], capture.masked, capture.generated
    unmasked = [capture.names[index] for index in indices if index not in masked]
    if unmasked:
        lines.append(f"{', '.join(unmasked)}: no mattes, so only the whole image is scored")
    made = [capture.names[index] for index in indices if index in generated]
    if made and len(generated) < len(masked):
        lines.append(
            f"{', '.join(made)}: no masks, so the matte's box is that of mattes made from other cameras' masks"
        )
    return lines


def _truth(picture: NDArray[np.uint8], matte: NDArray[np.uint8] | None) -> NDArray[np.float32]:
    """Convert an image (H, W, 3) to [0, 1]. If a matte (H, W) is given, the background becomes black."""
    import numpy as np

    share = 1.0 if matte is None else matte[..., None] / 255
    return (picture * (share / 255)).astype(np.float32)


def _backgrounds(
    trained: TrainedRun | SegmentedRun, indices: list[int], folder: Path, fitted: dict[int, FittedView]
) -> dict[str, float]:
    """Compare the rendered background of each camera with the image of the same camera in ``folder``. Returns the PSNR
    in dB, keyed by camera name."""
    from fourd.reconstruction.training.evaluation.metrics import psnr
    from fourd.reconstruction.training.segments.segmented_run import SegmentedRun
    from fourd.recording.capture.decoding import decode_rgb

    if isinstance(trained, SegmentedRun) or trained.renderer.background is None:
        raise UserError("--plates: expected a run with --scene full, got a run with --scene object; leave --plates out")
    layers = trained.run.config.train.layers
    scores = {}
    for index in indices:
        name, camera = trained.run.capture.names[index], trained.run.capture.cameras[index]
        truth = decode_rgb(folder / f"{name}.png")
        if truth.shape[:2] != (camera.height, camera.width):
            raise UserError(
                f"{folder / f'{name}.png'}: expected {camera.width} x {camera.height} pixels, "
                f"got {truth.shape[1]} x {truth.shape[0]}; resize the image"
            )
        if index in fitted:
            camera = fitted[index].camera
        picture = trained.renderer.render_background(camera, layers, exclude=index)
        rgb = _display_colours(trained, index, fitted, picture)
        scores[name] = float(psnr(rgb, _truth(truth, None)))
    return scores


def _evaluated_views(trained: TrainedRun | SegmentedRun, arguments: Arguments) -> list[int]:
    from fourd.recording.capture.layout import select_views

    names = trained.run.capture.names
    chosen = chosen_views(arguments.views, arguments.exclude_views)
    if arguments.views is not None:
        return [names.index(name) for name in select_views(chosen, names)]
    if not trained.run.test:
        raise UserError(
            f"{trained.run.folder}: expected held-out views, got a run that was trained on all views; "
            f"train with --test-views, or name training views with --views"
        )
    held_out = [names[index] for index in trained.run.test]
    return [names.index(name) for name in select_views(chosen, held_out)]


def _print(evaluation: Evaluation, trained: TrainedRun | SegmentedRun, backgrounds: dict[str, float]) -> None:
    import numpy as np
    from rich.table import Table

    table = Table(title=f"{trained.run.folder} at step {trained.step}: {len(evaluation.pictures)} images")
    for column in ("", "PSNR dB", "SSIM", "LPIPS"):
        table.add_column(column, justify="right" if column else "left")
    for label, scores in (("whole image", evaluation.image), ("inside the matte's box", evaluation.box)):
        if scores is not None:
            table.add_row(label, f"{scores.psnr:.2f}", _shown(scores.ssim), _shown(scores.lpips))
    if evaluation.covisible is not None:
        table.add_row("visible in a training view", f"{evaluation.covisible:.2f}", "", "")
    if backgrounds:
        table.add_row("background alone", f"{np.mean(list(backgrounds.values())):.2f}", "", "")
    Terminal().print(table)


def _shown(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.4f}"
