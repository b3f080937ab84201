"""Measure rendering time as a function of the number of points, pixels and layers (points composited per pixel).

The program writes a log-log plot and prints a table for each of the three. The last row of a table gives the growth
exponent, which is 1 for linear growth. It is the slope of a line that is fitted to log time as a function of the
logarithm of the varied number, at the three largest values of this number ("upper half").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import matplotlib
import numpy as np
import tyro

from fourd.base.files import atomic_path
from fourd.benchmarks.cases import composite
from fourd.benchmarks.machine import this_machine
from fourd.benchmarks.timing import Clock
from fourd.benchmarks.workloads import make_baked_frame, make_camera, make_cloud
from fourd.scene.player import Player
from tools.measurements import tables

POINTS = (16_384, 65_536, 262_144, 1_048_576, 2_097_152)
SIZES = ((256, 256), (512, 512), (1024, 1024), (1920, 1080), (3840, 2160))
LAYERS = (1, 2, 4, 8, 15, 30)
KINDS = ("forward", "forward + backward", "play")


@dataclass(frozen=True)
class Arguments:
    """Options of the measurement.

    Each series varies one of three quantities: the number of points, the number of pixels or the number of layers K,
    which is the maximum number of points composited per pixel. The other two quantities keep their base values: 262,144
    points, 1920 x 1080 pixels and K = 15.
    """

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("docs/figures/scaling.png")
    """PNG file of the plot."""
    seconds: float = 2.0
    """Approximate time in seconds spent on each measurement."""


@dataclass(frozen=True)
class Series:
    """The time of each kind of work, such as rendering, as a function of one quantity.

    ``axis`` names the quantity (points, pixels or layers), ``positions`` are its values, and ``milliseconds`` contains
    the times at these values for each kind of work.
    """

    axis: str
    positions: list[int]
    milliseconds: dict[str, list[float]]

    def slope(self, kind: str) -> float:
        """Return the log-log slope of the time, fitted to the upper half of the positions.

        A slope of 1 means linear growth.
        """
        half = len(self.positions) // 2
        x, y = np.log(self.positions[half:]), np.log(self.milliseconds[kind][half:])
        return float(np.polyfit(x, y, 1)[0])


def main(arguments: Arguments) -> None:
    """Measure all series, then write the plot and print the tables."""
    clock = Clock(arguments.seconds)
    base = (262_144, (1920, 1080), 15)
    series = [
        measure("points", list(POINTS), lambda n: (n, base[1], base[2]), clock),
        measure("pixels", [w * h for w, h in SIZES], lambda n: (base[0], by_pixels()[n], base[2]), clock),
        measure("layers", list(LAYERS), lambda n: (base[0], base[1], n), clock),
    ]
    plot(series, arguments.out)
    print(
        f"{this_machine()}\nmilliseconds; {base[0]:,} points, {base[1][0]} x {base[1][1]} pixels, K = {base[2]} layers"
    )
    for item in series:
        print(f"\n{table(item)}")


def by_pixels() -> dict[int, tuple[int, int]]:
    """Return a mapping from the number of pixels in an image to the image size (width, height)."""
    return {width * height: (width, height) for width, height in SIZES}


def measure(
    axis: str, positions: list[int], setting: Callable[[int], tuple[int, tuple[int, int], int]], clock: Clock
) -> Series:
    """Measure the time of every kind of work at each value in ``positions``.

    ``setting`` converts a position to the number of points, the image size and the number of layers.
    """
    found: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for position in positions:
        count, size, layers = setting(position)
        view, cloud = make_camera(*size), make_cloud(count)
        frame, scene = make_baked_frame(count)
        player = Player()
        works = (
            composite(cloud, view, layers, False),
            composite(cloud, view, layers, True),
            lambda f=frame, v=view, s=scene, k=layers, p=player: p.draw(f, v, s, layers=k),
        )
        for kind, work in zip(KINDS, works, strict=True):
            found[kind].append(clock.time(work).ms)
        print(axis, position, *(f"{kind} {found[kind][-1]:.1f} ms" for kind in KINDS), flush=True)
    return Series(axis, positions, found)


def plot(series: list[Series], path: Path) -> None:
    """Draw one log-log plot for each varied quantity (see :class:`Series`), with a reference line of slope 1."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    drawing, axes = pyplot.subplots(1, len(series), figsize=(12, 3.6), constrained_layout=True, sharey=True)
    for axis, item in zip(axes, series, strict=True):
        for kind in KINDS:
            axis.loglog(item.positions, item.milliseconds[kind], marker="o", label=kind)
        last = item.milliseconds[KINDS[0]][-1]
        line = [last * position / item.positions[-1] for position in item.positions]
        axis.loglog(item.positions, line, color="0.6", linestyle=":", label="slope 1")
        axis.set_xlabel(item.axis)
        axis.grid(True, which="both", alpha=0.2)
    axes[0].set_ylabel("ms")
    axes[0].legend(fontsize=8)
    with atomic_path(path) as temporary:
        drawing.savefig(temporary, dpi=110, format="png")


def table(series: Series) -> str:
    """Return a Markdown table with one row per position, and the log-log slopes in the last row."""
    rows = [
        [f"{position:,}", *(f"{series.milliseconds[kind][index]:.1f}" for kind in KINDS)]
        for index, position in enumerate(series.positions)
    ]
    rows.append(["exponent, upper half", *(f"{series.slope(kind):.2f}" for kind in KINDS)])
    return tables.table([series.axis, *KINDS], rows)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
