"""What each part of a full scene gives: the same short run without it, judged on held-out views.

    python tools/full_scene_ablations.py CAPTURE OUT --test-views 03,09,14 [--frames 0:24:6] [--max-steps 600]
                                         [--plates EMPTY_STAGE/] [--only sfm apart]

Each variant is a run in OUT/NAME, of the first's hull and background points where these are the same; runs that are
there are taken as they are. Prints a table in Markdown and writes
OUT/pictures.png: of each held-out view the truth and what every variant shows, at the middle frame.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from fourd.training.run import load_run

VARIANTS: dict[str, tuple[str, dict[str, object]]] = {
    "whole": ("everything", {}),
    "visible": ("no occlusion test", {"model": {"occlusion": False}}),
    "fixed": ("no densification", {"densify": {"on": False}}),
    "sfm": ("sfm instead of ngp", {"background": {"seeding": "sfm"}}),
    "apart": ("separate instead of joint", {"background": {"joint": False}}),
    "shadow": ("with shadows", {"background": {"shadow": True}}),
}
SIDE = 256
"""Of a tile, pixels."""
FOURD = [sys.executable, "-c", "import sys; from fourd.cli.main import main; sys.exit(main())"]


def train(name: str, arguments: argparse.Namespace) -> Path:
    """The run of a variant, with its scores beside it."""
    run = arguments.out / name
    overlay = arguments.out / f"{name}.yaml"
    overlay.write_text(yaml.safe_dump(VARIANTS[name][1]))
    if not run.exists():
        first = arguments.out / "whole"
        if name != "sfm" and first.exists():
            for shared in ("hull", "background"):
                shutil.copytree(first / shared, run / shared)
        told = ["--scene", "full", "--test-views", arguments.test_views, "--frames", arguments.frames]
        told += ["--max-steps", str(arguments.max_steps), "--config", str(overlay)]
        subprocess.run([*FOURD, "train", str(arguments.capture), "--out", str(run), *told], check=True)
    scores = arguments.out / f"{name}.json"
    if not scores.exists():
        plates = [] if arguments.plates is None else ["--plates", str(arguments.plates)]
        subprocess.run([*FOURD, "eval", str(run), "--json", str(scores), *plates], check=True)
    return run


def row(name: str, out: Path) -> str:
    """A line of the table."""
    scores = json.loads((out / f"{name}.json").read_text())
    backgrounds = scores.get("background")
    alone = "" if not backgrounds else f"{np.mean(list(backgrounds.values())):.2f}"
    image, box = scores["image"], scores["box"]
    return f"| {VARIANTS[name][0]} | {image['psnr']:.2f} | {image['ssim']:.3f} | {box['psnr']:.2f} | {alone} |"


def shown(run: Path) -> list[NDArray[np.uint8]]:
    """What a run shows to its held-out cameras, BGR."""
    trained = load_run(run)
    capture, frame = trained.run.capture, trained.run.capture.frame_count // 2
    layers = trained.run.config.train.layers
    tiles = []
    for camera in trained.run.test:
        picture = trained.renderer.render(trained.frames.get(frame), frame, capture.cameras[camera], layers)
        tiles.append(_tile((picture.rgb[..., ::-1] * 255 + 0.5).astype(np.uint8)))
    return tiles


def truth(run: Path) -> list[NDArray[np.uint8]]:
    """The same in truth."""
    opened = load_run(run).run
    frame = opened.capture.frame_count // 2
    return [_tile(opened.capture.image(camera, frame)[..., ::-1]) for camera in opened.test]


def _tile(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    scale = SIDE / max(picture.shape[:2])
    size = (round(picture.shape[1] * scale), round(picture.shape[0] * scale))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def main() -> None:
    """Train, judge, tell and draw."""
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
    print("| | whole image, PSNR dB | SSIM | matte's box, PSNR dB | background alone, PSNR dB |\n|---|---|---|---|---|")
    for name in arguments.only:
        print(row(name, arguments.out))
    columns = [truth(runs[0])] + [shown(run) for run in runs]
    grid = np.concatenate([np.concatenate(column, axis=0) for column in columns], axis=1)
    if not cv2.imwrite(str(arguments.out / "pictures.png"), grid):
        raise OSError(f"{arguments.out / 'pictures.png'}: cannot be written")


if __name__ == "__main__":
    main()
