"""Prints the sizes of a packed scene."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from fourd.baking.packing.pack import PackReport

CONTENTS = {
    "points": "positions, radii, densities",
    "sh": "spherical harmonics",
    "colour": "mean colours",
    "views": "colours and blend weights of all source views",
    "shadow": "shadows on the background",
    "optional": "optional attributes",
}


def print_sizes(console: Console, path: Path, report: PackReport) -> None:
    """Print a table of bytes per frame, and the size of the file."""
    table = Table(box=None, pad_edge=False)
    table.add_column("part")
    table.add_column("kB per frame", justify="right")
    for kind, size in report.parts.items():
        if kind != "background":
            table.add_row(CONTENTS.get(kind, kind), f"{size / 1e3:.1f}")
    table.add_row("one viewer fetches", f"{report.streamed / 1e3:.1f}")
    console.print(table)
    if "background" in report.parts:
        console.print(f"background, once: {report.parts['background'] / 1e6:.2f} MB")
    line = f"{path}: {report.bytes / 1e6:.1f} MB; next: fourd view {path}"
    console.print(line, soft_wrap=True, markup=False)
