"""Write a web page that plays a scene, for any web server."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from fourd.baking.files.encoding import Tier
from fourd.cli.options import TIER_HELP, ScenePath, describe, option
from fourd.progress import Tracker


@dataclass(frozen=True)
class Arguments:
    """Writes a folder of static files: a page, a poster image, the player and the scene."""

    scene: ScenePath
    """The .4dv file to show, of any version. Packed scenes keep their tier."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The folder to write. An earlier site in this folder is replaced."""
    tier: Annotated[Tier, describe(*TIER_HELP)] = "stream"
    title: Annotated[str | None, option("TEXT", "the name of the file")] = None
    """Title of the page."""


def run(arguments: Arguments) -> None:
    """Write the folder and print its size."""
    from fourd.viewer.publish.site import write_site

    console = Console(stderr=True)
    write_site(arguments.scene, arguments.out, arguments.tier, arguments.title, Tracker(console).track)
    size = sum(path.stat().st_size for path in arguments.out.rglob("*") if path.is_file()) / 1e6
    line = f"{arguments.out}: {size:.1f} MB; next: fourd serve {arguments.out}"
    console.print(line, soft_wrap=True, markup=False)
