"""Measure the size and image quality of packed scenes, and of the same frames in file formats of other programs.

    python tools/measurements/quality/rate_distortion.py scene.4dv CAPTURE --views 03,09,14 -o rates/ \\
        --transform splat-transform

The program packs the scene in all levels (sets of quantisation steps). It also exports 3DGS PLY files, which
splat-transform (npm: @playcanvas/splat-transform) converts to compressed PLY, SPZ and SOG, and back to PLY. The same
renderer draws all results, and the images are compared with captured images of held-out cameras. PSNR is measured
inside the subject's bounding box, or in the whole image if the scene has a background. The program writes
rates/rows.json and the plot rates/rates.png, and prints a Markdown table.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import matplotlib
import numpy as np
import tyro

from fourd.base.files import atomic_path, write_text_atomically
from fourd.reconstruction.training.evaluation.metrics import mask_box, psnr
from fourd.reconstruction.training.evaluation.scores import BOX_MARGIN_PX
from fourd.recording.capture.reader import Capture, open_capture
from fourd.scene import Scene, open_scene
from fourd.scene.exporting.export import ExportSettings, export_scene
from fourd.scene.files.encoding import Tier
from fourd.scene.packing.pack import pack_scene
from fourd.scene.packing.precision import LEVELS
from tools.measurements import tables

CONVERTED = {"compressed PLY": ".compressed.ply", "SPZ": ".spz", "SOG": ".sog"}
"""Formats of splat-transform, and the file suffix that selects each format."""
MARKERS = {"full": "s", "stream": "o", "video": "D", "light": "^"}
"""Markers of the tiers in the plot."""
TICKS_KB = (50, 100, 200, 500, 1000, 2000, 5000, 10000)


@dataclass(frozen=True)
class Arguments:
    """The scene, the ground truth, and the formats and levels to measure."""

    scene: tyro.conf.Positional[Path]
    """An unpacked .4dv file."""
    capture: tyro.conf.Positional[Path]
    """The capture with the ground-truth images and mattes."""
    views: str
    """Names of the cameras whose captured images are compared with the rendered ones, separated by commas."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for rows.json, rates.png and the exported files. Rows that rows.json already contains are not measured
    again."""
    every: int = 8
    """Step between the frames that are exported to other formats: with 8, every eighth frame is exported. A large step
    saves time, because the conversion to SOG is slow."""
    levels: tuple[str, ...] = tuple(f"{tier}{level + 1}" for tier in LEVELS for level in range(len(LEVELS[tier])))
    """Levels (sets of quantisation steps) at which the scene is packed and measured, for example `stream2`. The default
    is all levels."""
    transform: Path | None = None
    """Path of the program splat-transform. If it is not given, only the unpacked and packed scenes are measured, and
    not 3DGS PLY, compressed PLY, SPZ and SOG."""
    degrees: tuple[int, ...] = (0, 1, 2, 3)
    """Degrees of spherical harmonics at which splats are exported."""


@dataclass(frozen=True)
class Row:
    """One point of a rate-distortion curve.

    ``size`` is the number of bytes per frame. To draw a frame of a packed scene from one camera, a player downloads
    only ``fetched`` of these bytes: it leaves out source views that this camera does not need. ``psnr`` maps each frame
    to the mean PSNR over the cameras, in dB. ``background`` is the size in bytes of the background, which a scene
    stores only once.
    """

    curve: str
    name: str
    size: float
    fetched: float
    psnr: dict[str, float]
    background: float = 0.0

    def mean_psnr(self, frames: list[str]) -> float:
        return float(np.mean([self.psnr[frame] for frame in frames]))


class Truth:
    """The captured images of some cameras. For scenes without a background, they are black outside the matte."""

    def __init__(self, scene: Scene, capture: Capture, views: list[str]) -> None:
        self._cameras = {view: scene.manifest.camera(view) for view in views}
        self._numbers = [list(capture.frame_numbers).index(number) for number in scene.manifest.frame_numbers]
        self._capture = capture
        self._is_whole = scene.manifest.kind == "full"

    def score(self, scene: Scene, index: int, frame: int) -> float:
        """Compare frame ``index`` of ``scene`` with frame ``frame`` of the capture. Return the mean PSNR in dB over the
        cameras."""
        scores = []
        for view, camera in self._cameras.items():
            source, number = self._capture.names.index(view), self._numbers[frame]
            image, matte = self._capture.image(source, number) / 255, self._capture.mask(source, number)
            inside = slice(None), slice(None)
            if not self._is_whole:
                image *= matte[..., None] / 255
                box = mask_box(matte, margin=BOX_MARGIN_PX)
                if box is None:
                    continue
                inside = slice(box[0], box[1]), slice(box[2], box[3])
            rendered = scene.render(camera, index).rgb
            scores.append(float(psnr(rendered[inside], image[inside].astype(np.float32))))
        return float(np.mean(scores))


def main(arguments: Arguments) -> None:
    """Measure all rows that rows.json does not contain yet. Print the table and draw the curves of all rows."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "rows.json"
    rows = [Row(**row) for row in json.loads(path.read_text())] if path.exists() else []
    known = {row.name for row in rows}
    with open_scene(arguments.scene) as scene:
        truth = Truth(scene, open_capture(arguments.capture), arguments.views.split(","))
        for row in _measure(arguments, scene, truth, known):
            rows.append(row)
            write_text_atomically(path, json.dumps([asdict(row) for row in rows], indent=1) + "\n")
    common = sorted(set.intersection(*(set(row.psnr) for row in rows)), key=int)
    print_table(rows, common)
    plot(rows, common, arguments.out / "rates.png")


def print_table(rows: list[Row], common: list[str]) -> None:
    """Print the rows, with the mean PSNR over the frames that all rows have in common."""
    print(f"PSNR over the frames {', '.join(common)}, and over all measured frames\n")
    titles = ["files", "kB per frame", "fetched, kB per frame", "background, kB", "PSNR", "PSNR, all measured"]
    print(tables.head(titles))
    for row in rows:
        sizes = [f"{size / 1e3:,.0f}" for size in (row.size, row.fetched, row.background)]
        measured = np.mean(list(row.psnr.values()))
        print(tables.row([row.name, *sizes, f"{row.mean_psnr(common):.2f} dB", f"{measured:.2f} dB"]))


def plot(rows: list[Row], common: list[str], path: Path) -> None:
    """Draw one curve for each tier (kind of packed scene) and one for each other format, averaged over the frames that
    all rows have in common."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(9, 4.5), layout="constrained")
    for curve in dict.fromkeys(row.curve for row in rows):
        chosen = sorted((row for row in rows if row.curve == curve), key=lambda row: row.fetched)
        is_ours = curve in MARKERS
        label = f".4dv, tier {curve}" if is_ours else f".4dv, {curve}" if curve == "not packed" else curve
        style = {"marker": MARKERS.get(curve, "x"), "linestyle": "-" if is_ours else "--"}
        quality = [row.mean_psnr(common) for row in chosen]
        axes.plot([row.fetched / 1e3 for row in chosen], quality, label=label, **style)
    axes.set_xscale("log")
    axes.set_xticks(TICKS_KB, [f"{tick:,}" for tick in TICKS_KB])
    axes.minorticks_off()
    axes.set_xlabel("kB per frame that one viewer fetches")
    axes.set_ylabel("PSNR of held-out views in the subject's box, dB")
    axes.grid(alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")


def _measure(arguments: Arguments, scene: Scene, truth: Truth, known: set[str]) -> Iterator[Row]:
    if "not packed" not in known:
        background = scene.manifest.background_nbytes
        size = float(np.mean([scene.manifest.frame_nbytes(index) - background for index in range(len(scene))]))
        yield Row("not packed", "not packed", size, size, _score_all(scene, truth), background)
    for tier, levels in LEVELS.items():
        for level in range(len(levels)):
            if f"{tier}{level + 1}" in arguments.levels and f"{tier}, level {level + 1}" not in known:
                yield _measure_level(arguments, truth, tier, level)
    if arguments.transform is not None:
        for degree in arguments.degrees:
            yield from _measure_splats(arguments, scene, truth, degree, known)


def _score_all(scene: Scene, truth: Truth) -> dict[str, float]:
    return {str(frame): truth.score(scene, frame, frame) for frame in range(len(scene))}


def _measure_level(arguments: Arguments, truth: Truth, tier: Tier, level: int) -> Row:
    path = arguments.out / f"{tier}{level + 1}.4dv"
    report = pack_scene(arguments.scene, path, tier, level=level)
    size = sum(size for part, size in report.parts.items() if part != "background")
    with open_scene(path) as packed:
        background = report.parts.get("background", 0.0)
        return Row(tier, f"{tier}, level {level + 1}", size, report.streamed, _score_all(packed, truth), background)


def _measure_splats(arguments: Arguments, scene: Scene, truth: Truth, degree: int, known: set[str]) -> Iterator[Row]:
    """Export splats with spherical harmonics up to ``degree``, convert them to other formats and back, and yield one
    row for each format that is not in ``known``."""
    frames = list(range(0, len(scene), arguments.every))
    folder = arguments.out / f"degree{degree}"
    settings = ExportSettings("ply-sequence", frames, degree, keep_axes=True)
    files = export_scene(scene, folder, settings).files
    for curve, suffix in {"3DGS PLY": ".ply", **CONVERTED}.items():
        name = f"{curve}, degree {degree}"
        if name in known:
            continue
        sizes, scores = [], {}
        for frame, file in zip(frames, files, strict=True):
            stored, returned = file, file
            if suffix != ".ply":
                stored = arguments.out / f"degree{degree}-{frame:06d}{suffix}"
                returned = arguments.out / f"back-{stored.name.replace('.', '-')}.ply"
                _transform(arguments, file, stored)
                _transform(arguments, stored, returned)
            sizes.append(stored.stat().st_size)
            with open_scene(returned) as splats:
                scores[str(frame)] = truth.score(splats, 0, frame)
        size = float(np.mean(sizes))
        yield Row(curve, name, size, size, scores)


def _transform(arguments: Arguments, source: Path, out: Path) -> None:
    subprocess.run([str(arguments.transform), "-q", "-w", "-g", "cpu", str(source), str(out)], check=True)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
