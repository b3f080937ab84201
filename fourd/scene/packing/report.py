"""Packs a scene with the user's settings, and prints the sizes of its parts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from fourd.base.progress import Tracker
from fourd.scene.files.encoding import Tier
from fourd.scene.packing.pack import PackReport, pack_scene
from fourd.scene.packing.rate import choose_tier

CONTENTS = {
    "points": "positions, radii, densities",
    "sh": "spherical harmonics",
    "colour": "mean colours",
    "views": "colours and blend weights of all source views",
    "images": "images and blend weights of all source views",
    "shadow": "shadows on the background",
    "optional": "optional attributes",
}
"""Description of each kind of member, for the printed table."""


@dataclass(frozen=True)
class PackSettings:
    """The tier (quality) of a packed scene, or the data rate of the connection for which the tier is chosen, in
    megabits per second.

    If ``max_mbps`` is given, the best tier for this rate is chosen, and ``tier`` is ignored.
    """

    tier: Tier
    max_mbps: float | None = None


def pack_and_report(
    source: Path, out: Path, settings: PackSettings, console: Console, name: Path | None = None
) -> None:
    """Pack the scene ``source`` as ``out``, and print the sizes of its parts, such as the mean colours. Raises
    UserError in the same cases as :func:`pack_scene` and :func:`choose_tier`.

    ``name`` is the file name in error messages; None stands for ``source``.
    """
    tier, level, track = settings.tier, None, Tracker(console).track
    if settings.max_mbps is not None:
        choice = choose_tier(source, settings.max_mbps, name or source, track=track)
        tier, level = choice.tier, choice.level
        console.print(f"--max-mbps {settings.max_mbps:g}: {choice}", soft_wrap=True)
    print_sizes(console, pack_scene(source, out, tier, track, level=level))


def print_sizes(console: Console, report: PackReport) -> None:
    """Print a table with the kilobytes per frame of each part of a packed scene. The parts are described in
    :data:`CONTENTS`."""
    table = Table(box=None, pad_edge=False)
    table.add_column("part")
    table.add_column("kB per frame", justify="right")
    for kind, size in report.parts.items():
        if kind != "background":
            content = "images" if kind == "views" and report.colour_psnr is not None else kind
            table.add_row(CONTENTS.get(content, content), f"{size / 1e3:.1f}")
    table.add_row("fetched for one viewer", f"{report.streamed / 1e3:.1f}")
    console.print(table)
    if "background" in report.parts:
        console.print(f"background, stored once: {report.parts['background'] / 1e6:.2f} MB")
    if report.colour_psnr is not None:
        console.print(f"PSNR of the colours in the source views: {report.colour_psnr:.1f} dB")
