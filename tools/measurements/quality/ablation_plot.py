"""Train ablations on one capture, and plot and tabulate the held-out PSNR over training time.

    python tools/measurements/quality/ablation_plot.py CAPTURE --test-views 03,09,14 --frames 0:1 --seconds 180

The program writes the plot to --out and prints the table. Finished runs in the folder --work are not trained again.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import matplotlib
import tyro
from rich.console import Console

from fourd.base.files import atomic_path
from fourd.pipeline.make import create_run
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.run import load_run
from tools.measurements.tables import table

ABLATIONS = {"both": "images and SH", "ibr": "images alone", "sh": "SH alone"}


@dataclass(frozen=True)
class Arguments:
    """Options of the comparison."""

    capture: tyro.conf.Positional[Path]
    """The capture's folder."""
    test_views: str
    """Names of held-out cameras, separated by commas."""
    frames: str = "0:1"
    """Range of frames as A:B, without frame B."""
    seconds: float = 180.0
    """Training time of each ablation in seconds."""
    every: float = 10.0
    """Seconds of training between two validations."""
    work: Path = Path("ablations")
    """Folder for the runs."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("docs/figures/ablations.png")
    """PNG file of the plot."""


def main(arguments: Arguments) -> None:
    """Train the runs that are missing, then write the plot and print the table."""
    curves = {name: _curve(arguments, name) for name in ABLATIONS}
    _draw(arguments, curves)
    rows = []
    for name, title in ABLATIONS.items():
        values = [min(curves[name], key=lambda point: abs(point[0] - mark))[1] for mark in _marks(arguments)]
        rows.append([title, *(f"{value:.2f}" for value in values)])
    print(table(["colour", *(f"{mark:.0f} s" for mark in _marks(arguments))], rows))


def _marks(arguments: Arguments) -> list[float]:
    return [arguments.seconds * share for share in (0.125, 0.25, 0.5, 0.75, 1.0)]


def _curve(arguments: Arguments, name: str) -> list[tuple[float, float]]:
    """Return the training time in seconds and the held-out PSNR of each validation of an ablation. The PSNR is measured
    inside the bounding box of the matte."""
    folder = arguments.work / name
    base = TrainConfig()
    config = replace(
        base,
        model=replace(base.model, appearance=name),
        test_views=tuple(arguments.test_views.split(",")),
        frames=arguments.frames,
        max_seconds=arguments.seconds,
        validation_seconds=arguments.every,
    )
    if not list(folder.glob("checkpoints/*.safetensors")):
        Trainer(create_run(arguments.capture, folder, config), None, Console(stderr=True), config).train()
    load_run(folder)
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return [(line["seconds"], line["validation/psnr"]) for line in lines if "validation/psnr" in line]


def _draw(arguments: Arguments, curves: dict[str, list[tuple[float, float]]]) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4), layout="constrained")
    for name, title in ABLATIONS.items():
        seconds, values = zip(*curves[name], strict=True)
        axes.plot(seconds, values, marker="o", markersize=3, label=title)
    axes.set_xlabel("training time on 2 CPU cores, s")
    axes.set_ylabel("held-out PSNR in the mattes' box, dB")
    axes.set_title(f"{arguments.capture.name}, frames {arguments.frames}, held out {arguments.test_views}")
    axes.grid(alpha=0.3)
    axes.legend()
    with atomic_path(arguments.out) as temporary:
        figure.savefig(temporary, dpi=130, format="png")


if __name__ == "__main__":
    main(tyro.cli(Arguments))
