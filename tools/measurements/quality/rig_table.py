"""Measure what each factor of a real rig costs: train a clean capture and the same capture as a rig records it, with
one factor at a time and with all together (fourd synth --rig), and compare the held-out views.

    python tools/measurements/quality/rig_table.py CAPTURE [CAPTURE ...] --out FOLDER --test-views 03,09,14
        [--max-steps 1000] [--only clean noise together] [--json rig.json]

All runs use the clean capture's held-out images and masks as the truth, and the true held-out cameras, which are
aligned to the cameras of the run by a similarity transform. `fourd eval` instead compares with recorded images. The
runs of single factors train with the true mattes of the recorded images, so that they measure this factor alone. The
rows "mattes" and "together" train with automatic mattes.

Everything is kept in FOLDER/CAPTURE/ROW. A repeated command measures only what is missing or was measured with other
options, so it can be interrupted. A capture of fourd synth is recorded between its frames, other captures are blended.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.limits import read_json
from fourd.reconstruction.training.evaluation.defects import flicker
from fourd.reconstruction.training.evaluation.metrics import mask_box
from fourd.reconstruction.training.evaluation.scores import BOX_MARGIN_PX
from fourd.reconstruction.training.run import TrainedRun, load_run
from fourd.recording.calibration.scale import align_cameras
from fourd.recording.capture import open_capture
from fourd.recording.capture.layout import link_entries
from fourd.recording.capture.split import read_test_views
from fourd.recording.synth.folder import read_settings
from fourd.recording.synth.rig import FACTORS
from tools.measurements.tables import table

Image = NDArray[np.float32]
FOURD = (sys.executable, "-m", "fourd")


@dataclass(frozen=True)
class Row:
    """A row of the table: the factors of the rig, and whether training gets true mattes."""

    factors: str | None
    has_mattes: bool


@dataclass(frozen=True)
class Arguments:
    """What to measure."""

    captures: tyro.conf.Positional[list[Path]]
    """Clean captures with masks."""
    out: Path
    """Folder for the recorded captures, the runs and the results."""
    max_steps: int = 1000
    """Number of training steps of each run."""
    test_views: str | None = None
    """Names of held-out cameras, separated by commas. The default is each capture's split.json."""
    together: str = "all"
    """Value of --rig for the rows with several factors."""
    only: list[str] | None = None
    """Names of the rows to measure. The default is all rows."""
    seed: int = 0
    """Seed of the rig and of training. The rig of a capture of fourd synth has the seed of that capture."""
    flags: str = ""
    """Further options of all calls of fourd make, for example --flags='--points 8000'."""
    json: Path | None = None
    """JSON file for all results."""


@dataclass(frozen=True)
class Result:
    """Quality of a run, averaged over held-out views and frames.

    Attributes:
        psnr: PSNR in dB inside the true matte's bounding box.
        fitted: the same after an affine map of the colours was fitted to each held-out camera.
        flicker: mean absolute error of the change between successive images, divided by the true change.
    """

    psnr: float
    fitted: float
    flicker: float


@torch.no_grad()
def main(arguments: Arguments) -> int:
    """Print a Markdown table for each capture, with a row for each measured recording."""
    found = rows(arguments.together)
    try:
        unknown = [name for name in arguments.only or [] if name not in found]
        if unknown:
            raise UserError(f"--only: expected rows among {', '.join(found)}, got '{unknown[0]}'")
        chosen = {name: row for name, row in found.items() if name in (arguments.only or found)}
        results = {
            capture.name: {name: measured(capture, name, row, arguments) for name, row in chosen.items()}
            for capture in arguments.captures
        }
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    for name, of_capture in results.items():
        print(f"{name}, {arguments.max_steps} steps\n\n{markdown(of_capture)}\n")
    if arguments.json is not None:
        content = {name: {row: asdict(each) for row, each in of.items()} for name, of in results.items()}
        content = {"max_steps": arguments.max_steps, "together": arguments.together, "captures": content}
        write_text_atomically(arguments.json, json.dumps(content, indent=1) + "\n")
    return 0


def rows(together: str) -> dict[str, Row]:
    """Return all rows, with the clean capture first."""
    single = {name: Row(name, True) for name in FACTORS}
    whole = {"together, true mattes": Row(together, True), "together": Row(together, False)}
    return {"clean": Row(None, True), "mattes": Row(None, False), **single, **whole}


def measured(capture: Path, name: str, row: Row, arguments: Arguments) -> Result:
    """Return the result of a row. It is measured if there is none of the same options."""
    folder = arguments.out / capture.name / name.replace(", ", "-").replace(" ", "-")
    views = arguments.test_views or ",".join(read_test_views(capture) or ())
    if not views:
        raise UserError(f"{capture}: expected held-out views, got none; name some with --test-views")
    options: dict[str, Any] = {"capture": str(capture.resolve()), **asdict(row), "test_views": views}
    options |= {"max_steps": arguments.max_steps, "seed": arguments.seed, "flags": arguments.flags}
    path = folder / "result.json"
    old = read_json(path) if path.exists() else {}
    if old.get("options") == options:
        return Result(**old["result"])
    recorded = folder / "capture"
    record(capture, recorded, row, arguments.seed)
    words = ["make", recorded, "-o", folder / "scene.4dv", "--work", folder / "work", "--tier", "none"]
    words += ["--test-views", views, "--max-steps", arguments.max_steps, "--seed", arguments.seed]
    call([*words, *shlex.split(arguments.flags)])
    trained = load_run(folder / "work" / "run")
    result = measure(trained, capture)
    trained.close()
    write_text_atomically(path, json.dumps({"options": options, "result": asdict(result)}, indent=1) + "\n")
    return result


def record(capture: Path, out: Path, row: Row, seed: int) -> None:
    """Make the capture that a row trains on."""
    if row.factors is None:
        out.mkdir(parents=True, exist_ok=True)
        link_entries(capture, out, left_out={".fourd", "synth.json"} | (set() if row.has_mattes else {"masks"}))
        return
    call(["synth", out, "--rig", row.factors, *source_options(capture, seed)])
    if row.has_mattes and not (out / "masks").exists():
        (out / "masks").symlink_to(Path("truth", "masks"))


def source_options(capture: Path, seed: int) -> list[object]:
    """Return the options of fourd synth --rig that name a clean capture. The figure of fourd synth is rendered again,
    because its motion between the frames is known."""
    figure = read_settings(capture)
    if figure is None or "dome" in figure:
        return ["--from", capture, "--seed", seed]
    names = ("frames", "cameras", "size", "seed", "gloss", "fps")
    return [word for name in names for word in (f"--{name}", figure[name])]


def call(words: Sequence[object]) -> None:
    """Run a command of fourd, which prints to stderr."""
    done = subprocess.run([*FOURD, *map(str, words)], stdout=sys.stderr)
    if done.returncode != 0:
        raise UserError(f"fourd {words[0]}: expected exit code 0, got {done.returncode}; see the messages above")


def measure(trained: TrainedRun, clean: Path) -> Result:
    """Compare the held-out views of a run with the images and masks of the clean capture."""
    used, layers = trained.run.capture, trained.run.config.train.layers
    with open_capture(clean, views=list(used.names)) as truth:
        poses = dict(zip(used.names, used.cameras, strict=True))
        cameras = align_cameras(dict(zip(truth.names, truth.cameras, strict=True)), poses)
        scores, flickers = [], []
        for view in trained.run.test:
            name = used.names[view]
            index = truth.names.index(name)
            pictures, truths, mattes = [], [], []
            for frame, number in enumerate(used.frame_numbers):
                rendered = trained.renderer.render(trained.frames.get(frame), frame, cameras[name], layers)
                matte = truth.mask(index, number)
                share = matte[..., None].astype(np.float32) / 255
                pictures.append(np.concatenate([rendered.rgb, rendered.alpha[..., None]], axis=2))
                truths.append(truth.image(index, number).astype(np.float32) / 255 * share)
                mattes.append(matte)
            scores += box_scores(pictures, truths, mattes)
            flickers.append(relative_flicker([picture[..., :3] for picture in pictures], truths))
    psnr, fitted = np.mean(scores, axis=0)
    return Result(float(psnr), float(fitted), float(np.mean(flickers)))


def box_scores(
    pictures: Sequence[Image], truths: Sequence[Image], mattes: Sequence[NDArray[np.uint8]]
) -> list[tuple[float, float]]:
    """Return the PSNR in dB of each image of a camera inside the matte's bounding box, without and with an affine map
    that is fitted to the colours of all its images. ``pictures`` have colours and alpha (H, W, 4): the constant of the
    map is multiplied by alpha, so that black stays black outside the subject."""
    pairs = []
    for picture, truth, matte in zip(pictures, truths, mattes, strict=True):
        top, bottom, left, right = mask_box(matte, BOX_MARGIN_PX) or (0, *matte.shape[:1], 0, *matte.shape[1:])
        inside = np.s_[top:bottom, left:right]
        pairs.append((picture[inside].reshape(-1, 4), truth[inside].reshape(-1, 3)))
    given, wanted = (np.concatenate(part) for part in zip(*pairs, strict=True))
    colour_map = np.linalg.lstsq(given.astype(np.float64), wanted.astype(np.float64), rcond=None)[0]
    return [(decibels(picture[:, :3] - truth), decibels(picture @ colour_map - truth)) for picture, truth in pairs]


def decibels(error: NDArray[np.floating]) -> float:
    """Return the PSNR in dB of an error with values in [-1, 1]."""
    return float(-10 * np.log10(max(float(np.mean(np.square(error))), 1e-10)))


def relative_flicker(pictures: Sequence[Image], truths: Sequence[Image]) -> float:
    """Return the flicker of successive images divided by the true change, or 0 for a single image."""
    if len(truths) < 2:
        return 0.0
    return flicker(pictures, truths) / max(flicker(truths, [truths[0]] * len(truths)), 1e-12)


def markdown(results: Mapping[str, Result]) -> str:
    """Return the table of one capture. Losses are differences from the row of the clean capture."""
    heads = ["recorded with", "held-out dB", "lost", "dB, colours fitted", "lost", "flicker / true change", "more"]
    return table(heads, cells(results))


def cells(results: Mapping[str, Result]) -> Iterator[list[str]]:
    """Yield the table's rows."""
    clean = results.get("clean")
    for name, result in results.items():
        values = [(f"{result.psnr:.2f}", "psnr", -1), (f"{result.fitted:.2f}", "fitted", -1)]
        values += [(f"{result.flicker:.3f}", "flicker", 1)]
        row = [name]
        for text, field, sign in values:
            digits = 3 if field == "flicker" else 2
            change = None if clean is None else sign * (getattr(result, field) - getattr(clean, field))
            row += [text, "-" if change is None or name == "clean" else f"{change:.{digits}f}"]
        yield row


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments, description=__doc__)))
