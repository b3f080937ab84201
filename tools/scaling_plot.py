"""Time rendering against points, pixels and layers: a table and a log-log plot in docs/."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
import tyro

from fourd.baking.player import Player
from fourd.benchmarks.cases import composite
from fourd.benchmarks.machine import this_machine
from fourd.benchmarks.timing import Clock
from fourd.benchmarks.workloads import baked_cloud, camera, figure
from fourd.files import atomic_path, write_text_atomically

POINTS = (16_384, 65_536, 262_144, 1_048_576, 2_097_152)
SIZES = ((256, 256), (512, 512), (1024, 1024), (1920, 1080), (3840, 2160))
LAYERS = (1, 2, 4, 8, 15, 30)
KINDS = ("forward", "forward + backward", "play")


@dataclass(frozen=True)
class Arguments:
    """The base is 262,144 points, 1920 x 1080 pixels, K = 15; one of the three changes at a time."""

    out: Path = Path("docs")
    """Folder for figures/scaling.png and measurements/scaling.md."""
    seconds: float = 2.0
    """Time spent on each measurement, about."""


@dataclass(frozen=True)
class Series:
    """Milliseconds of every kind at each place of an axis."""

    axis: str
    places: list[int]
    milliseconds: dict[str, list[float]]

    def slope(self, kind: str) -> float:
        """Exponent of the growth over the axis' upper half: 1 is linear."""
        half = len(self.places) // 2
        x, y = np.log(self.places[half:]), np.log(self.milliseconds[kind][half:])
        return float(np.polyfit(x, y, 1)[0])


def main(arguments: Arguments) -> None:
    """Measure, write, and say where."""
    clock = Clock(arguments.seconds)
    base = (262_144, (1920, 1080), 15)
    series = [
        measure("points", list(POINTS), lambda n: (n, base[1], base[2]), clock),
        measure("pixels", [w * h for w, h in SIZES], lambda n: (base[0], by_pixels()[n], base[2]), clock),
        measure("layers", list(LAYERS), lambda n: (base[0], base[1], n), clock),
    ]
    picture, page = arguments.out / "figures" / "scaling.png", arguments.out / "measurements" / "scaling.md"
    for path in (picture, page):
        path.parent.mkdir(parents=True, exist_ok=True)
    plot(series, picture)
    base_text = f"{base[0]:,} points, {base[1][0]} x {base[1][1]}, K = {base[2]}"
    text = f"# Scaling\n\n{this_machine()}\n\nMilliseconds. Base: {base_text}.\n\n"
    write_text_atomically(page, text + "\n".join(table(one) for one in series))
    print(f"{picture}, {page}")


def by_pixels() -> dict[int, tuple[int, int]]:
    """Sizes by their number of pixels."""
    return {width * height: (width, height) for width, height in SIZES}


def measure(
    axis: str, places: list[int], setting: Callable[[int], tuple[int, tuple[int, int], int]], clock: Clock
) -> Series:
    """Time every kind at each place."""
    found: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for place in places:
        count, size, layers = setting(place)
        view, cloud = camera(*size), figure(count)
        frame, scene = baked_cloud(count)
        player = Player()
        works = (
            composite(cloud, view, layers, False),
            composite(cloud, view, layers, True),
            lambda f=frame, v=view, s=scene, k=layers, p=player: p.draw(f, v, s, layers=k),
        )
        for kind, work in zip(KINDS, works, strict=True):
            found[kind].append(clock.time(work).ms)
        print(axis, place, *(f"{kind} {found[kind][-1]:.1f} ms" for kind in KINDS), flush=True)
    return Series(axis, places, found)


def plot(series: list[Series], path: Path) -> None:
    """One log-log diagram an axis, with a line of slope 1."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    drawing, axes = pyplot.subplots(1, len(series), figsize=(12, 3.6), constrained_layout=True, sharey=True)
    for axis, one in zip(axes, series, strict=True):
        for kind in KINDS:
            axis.loglog(one.places, one.milliseconds[kind], marker="o", label=kind)
        last = one.milliseconds[KINDS[0]][-1]
        line = [last * place / one.places[-1] for place in one.places]
        axis.loglog(one.places, line, color="0.6", linestyle=":", label="slope 1")
        axis.set_xlabel(one.axis)
        axis.grid(True, which="both", alpha=0.2)
    axes[0].set_ylabel("ms")
    axes[0].legend(fontsize=8)
    with atomic_path(path) as temporary:
        drawing.savefig(temporary, dpi=110)


def table(series: Series) -> str:
    """One row a place, and the exponent of the growth."""
    lines = [f"| {series.axis} | " + " | ".join(KINDS) + " |", "|---" * (len(KINDS) + 1) + "|"]
    for index, place in enumerate(series.places):
        lines.append(f"| {place:,} | " + " | ".join(f"{series.milliseconds[kind][index]:.1f}" for kind in KINDS) + " |")
    lines.append("| exponent, upper half | " + " | ".join(f"{series.slope(kind):.2f}" for kind in KINDS) + " |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main(tyro.cli(Arguments))
