"""Draw the rate-distortion curves that tools/plots/rate_distortion.py has measured.

python tools/plots/rate_plot.py rates/rows.json -o docs/figures/guide/rates.png
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import matplotlib
import numpy as np
import tyro

from fourd.files import atomic_path

MARKERS = {"full": "s", "stream": "o", "video": "D", "light": "^"}


@dataclass(frozen=True)
class Arguments:
    """Input and output files: the measured rows of the table, and the figure."""

    rows: tyro.conf.Positional[Path]
    """rows.json of tools/plots/rate_distortion.py."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The PNG file to write."""


def main(arguments: Arguments) -> None:
    """Draw one curve for each tier (kind of packed scene) and one for each other format, averaged over the frames that
    all rows have in common."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = json.loads(arguments.rows.read_text())
    frames = set.intersection(*(set(row["psnr"]) for row in rows))
    figure, axes = pyplot.subplots(figsize=(9, 4.5), layout="constrained")
    for curve in dict.fromkeys(row["curve"] for row in rows):
        chosen = sorted((row for row in rows if row["curve"] == curve), key=lambda row: row["fetched"])
        quality = [np.mean([row["psnr"][frame] for frame in frames]) for row in chosen]
        is_ours = curve in MARKERS
        label = f".4dv, tier {curve}" if is_ours else f".4dv, {curve}" if curve == "not packed" else curve
        style = {"marker": MARKERS.get(curve, "x"), "linestyle": "-" if is_ours else "--"}
        axes.plot([row["fetched"] / 1e3 for row in chosen], quality, label=label, **style)
    axes.set_xscale("log")
    ticks = (50, 100, 200, 500, 1000, 2000, 5000, 10000)
    axes.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
    axes.minorticks_off()
    axes.set_xlabel("kB per frame that one viewer fetches")
    axes.set_ylabel("PSNR of held-out views in the subject's box, dB")
    axes.grid(alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    with atomic_path(arguments.out) as temporary:
        figure.savefig(temporary, dpi=120, format="png")


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
