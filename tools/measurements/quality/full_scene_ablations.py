"""Run ablations on a full scene (subject and background): train each variant briefly and evaluate held-out views.

    python tools/measurements/quality/full_scene_ablations.py CAPTURE OUT --test-views 03,09,14
        [--frames 0:24:6] [--max-steps 600] [--plates EMPTY_SCENE/] [--only sfm apart]

Each variant is a run in OUT/NAME. Variants reuse the hull points and background points of the first variant, except for
the variants that change how these points are made. Finished runs are not trained again.

Two variants use the capture OUT/disturbed, in which each camera is rotated by 0.5 degrees and moved by 1 cm. Before
these two variants are evaluated, the pose of each held-out camera is fitted to the images of this camera, which raises
the scores of both variants slightly.

The program prints a Markdown table and writes the image OUT/pictures.png, which shows the middle frame of each held-out
view: the ground truth, and the result of every variant.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from fourd.reconstruction.training.run import load_run
from tools.measurements import tables
from tools.measurements.quality import disturbed_capture


@dataclass(frozen=True)
class Variant:
    """A training variant.

    Attributes:
        label: row title in the table.
        changes: the config keys that differ from the defaults.
        own_seeds: whether the run computes its own hull points and background points, instead of using those of the
            first variant.
        disturbed: whether the run uses the perturbed calibration.
    """

    label: str
    changes: dict[str, object] = field(default_factory=dict)
    own_seeds: bool = False
    disturbed: bool = False


REFINED: dict[str, object] = {"refine": {"poses": True, "focal": True}}
VARIANTS = {
    "whole": Variant("full method"),
    "visible": Variant("no occlusion test", {"model": {"occlusion": False}}),
    "fixed": Variant("no densification", {"densify": {"on": False}}),
    "sfm": Variant("background points from sfm", {"background": {"seeding": "sfm"}}, own_seeds=True),
    "apart": Variant("foreground and background trained separately", {"background": {"joint": False}}),
    "open": Variant("no opacity loss", {"loss": {"closed": 0.0}}),
    "shadow": Variant("with shadows", {"background": {"shadow": True}}),
    "refined": Variant("calibration off, refined", REFINED, own_seeds=True, disturbed=True),
    "unrefined": Variant("calibration off, no refinement", own_seeds=True, disturbed=True),
}
SIDE = 256
"""Longer side of each tile in OUT/pictures.png, in pixels."""
FOURD = [sys.executable, "-c", "import sys; from fourd.cli.main import main; sys.exit(main())"]


def train(name: str, arguments: argparse.Namespace) -> Path:
    """Train and evaluate a variant. Return its run folder."""
    variant = VARIANTS[name]
    run, overlay = arguments.out / name, arguments.out / f"{name}.yaml"
    overlay.write_text(yaml.safe_dump(variant.changes))
    capture = disturbed(arguments) if variant.disturbed else arguments.capture
    if not (run / "checkpoints").exists():
        first = arguments.out / "whole"
        if not variant.own_seeds and name != "whole" and first.exists():
            for shared in ("hull", "background"):
                shutil.copytree(first / shared, run / shared, dirs_exist_ok=True)
        flags = ["--scene", "full", "--test-views", arguments.test_views, "--frames", arguments.frames]
        flags += ["--max-steps", str(arguments.max_steps), "--config", str(overlay)]
        subprocess.run([*FOURD, "train", str(capture), "--out", str(run), *flags], check=True)
    scores = arguments.out / f"{name}.json"
    if not scores.exists():
        plates = [] if arguments.plates is None else ["--plates", str(arguments.plates)]
        fitted = ["--refine-test"] if variant.disturbed else []
        subprocess.run([*FOURD, "eval", str(run), "--json", str(scores), *plates, *fitted], check=True)
    return run


def disturbed(arguments: argparse.Namespace) -> Path:
    """Return the capture with the perturbed calibration, which is created if it is missing."""
    out: Path = arguments.out / "disturbed"
    if not out.exists():
        disturbed_capture.make(arguments.capture, out)
    return out


def cells(name: str, out: Path) -> list[str]:
    """Return the table row of a variant."""
    scores = json.loads((out / f"{name}.json").read_text())
    backgrounds = scores.get("background")
    alone = "" if not backgrounds else f"{np.mean(list(backgrounds.values())):.2f}"
    image, box = scores["image"], scores["box"]
    return [VARIANTS[name].label, f"{image['psnr']:.2f}", f"{image['ssim']:.3f}", f"{box['psnr']:.2f}", alone]


def render_test_views(run: Path) -> list[NDArray[np.uint8]]:
    """Render the middle frame of a run from its held-out cameras. Return BGR images."""
    trained = load_run(run)
    capture, frame = trained.run.capture, trained.run.capture.frame_count // 2
    layers = trained.run.config.train.layers
    tiles = []
    for camera in trained.run.test:
        picture = trained.renderer.render(trained.frames.get(frame), frame, capture.cameras[camera], layers)
        tiles.append(_tile((picture.rgb[..., ::-1] * 255 + 0.5).astype(np.uint8)))
    return tiles


def test_pictures(run: Path) -> list[NDArray[np.uint8]]:
    """Return the captured images (BGR) of the middle frame from a run's held-out cameras."""
    opened = load_run(run).run
    frame = opened.capture.frame_count // 2
    return [_tile(opened.capture.image(camera, frame)[..., ::-1]) for camera in opened.test]


def _tile(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    scale = SIDE / max(picture.shape[:2])
    size = (round(picture.shape[1] * scale), round(picture.shape[0] * scale))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def main() -> None:
    """Train and evaluate the variants, then write the table and the images."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--test-views", required=True)
    parser.add_argument("--frames", default="0:24:6")
    parser.add_argument("--max-steps", type=int, default=600)
    parser.add_argument("--plates", type=Path)
    parser.add_argument("--only", nargs="+", choices=list(VARIANTS), default=list(VARIANTS))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    runs = [train(name, arguments) for name in arguments.only]
    titles = ["", "whole image, PSNR dB", "SSIM", "matte's box, PSNR dB", "background alone, PSNR dB"]
    print(tables.table(titles, (cells(name, arguments.out) for name in arguments.only)))
    columns = [test_pictures(runs[0])] + [render_test_views(run) for run in runs]
    grid = np.concatenate([np.concatenate(column, axis=0) for column in columns], axis=1)
    if not cv2.imwrite(str(arguments.out / "pictures.png"), grid):
        raise OSError(f"{arguments.out / 'pictures.png'}: cannot be written")


if __name__ == "__main__":
    main()
