"""Convert a .4dv scene to a compact file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from fourd.baking.packing.encoding import Tier
from fourd.baking.packing.pack import pack_scene
from fourd.cli.options import describe
from fourd.cli.scenes.sizes import print_sizes
from fourd.progress import Tracker

ScenePath = tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="SCENE")]]


@dataclass(frozen=True)
class Arguments:
    """Frames are quantised and compressed. Every frame can be read alone, also over a network."""

    scene: ScenePath
    """The .4dv file to convert, of any version."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The .4dv file to write."""
    tier: Annotated[
        Tier,
        describe(
            "full: looks like the input.",
            "stream: coarser steps; a player fetches only the source views that it needs.",
            "light: no source views; all colour is in spherical harmonics.",
        ),
    ] = "full"


def run(arguments: Arguments) -> None:
    """Pack the scene and print the sizes of its parts."""
    console = Console(stderr=True)
    report = pack_scene(arguments.scene, arguments.out, arguments.tier, Tracker(console).track)
    print_sizes(console, arguments.out, report)
