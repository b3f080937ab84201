"""Measure what a scene loses in the formats of other programs, as a Markdown table.

    python tools/measurements/quality/interchange.py SCENE

The scene is exported with its axes kept, the files are read again by fourd, and both are rendered from cameras of the
scene. The PSNR is that of the pixels which the scene covers. The last rows pack
the file 4dgs of degree 1.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from fourd.recording.capture.layout import sample_indices
from fourd.scene import Scene, open_scene
from fourd.scene.exporting.export import ExportSettings, export_scene
from fourd.scene.exporting.format import Format
from fourd.scene.files.encoding import Tier
from fourd.scene.packing.pack import pack_scene

VIEWS, FRAMES = 6, 3
EXPORTS: tuple[tuple[Format, int], ...] = (("ply-sequence", 2), ("4dgs", 0), ("4dgs", 1), ("4dgs", 2), ("4dgs", 3))
TIERS: tuple[Tier, ...] = ("full", "stream", "light")


def main() -> None:
    """Print the table of the scene that the command line names."""
    with tempfile.TemporaryDirectory() as name, open_scene(sys.argv[1]) as scene:
        folder = Path(name)
        print("| file | kB per frame | PSNR against the scene |\n|---|---|---|")
        for kind, degree in EXPORTS:
            out = folder / (f"degree{degree}.4dgs" if kind == "4dgs" else kind)
            settings = ExportSettings(kind, range(len(scene)), degree, keep_axes=True)
            report = export_scene(scene, out, settings)
            print_row(f"`{kind}`, degree {degree}", report.bytes_per_frame, scene, out)
        for tier in TIERS:
            out = folder / f"{tier}.4dv"
            pack_scene(folder / "degree1.4dgs", out, tier)
            print_row(f"`4dgs`, degree 1, packed as `{tier}`", out.stat().st_size / len(scene), scene, out)


def print_row(name: str, frame_bytes: float, scene: Scene, path: Path) -> None:
    """Render the file and the scene, and print a row of the table."""
    cameras = scene.manifest.cameras
    errors = []
    with open_scene(path) as other:
        for frame in sample_indices(len(scene), FRAMES):
            for index in sample_indices(len(cameras), VIEWS):
                wanted, found = scene.render(cameras[index], frame), other.render(cameras[index], frame)
                errors.append(np.square(wanted.rgb - found.rgb)[wanted.alpha > 0.5].mean())
    print(f"| {name} | {frame_bytes / 1e3:.0f} | {-10 * np.log10(np.mean(errors)):.1f} dB |", flush=True)


if __name__ == "__main__":
    main()
