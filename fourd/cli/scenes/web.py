"""Write a web page that plays a scene, for any web server."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import urlsplit

import tyro
from rich.console import Console

from fourd.base.errors import UserError, command_line
from fourd.base.files import remove_unfinished_folder
from fourd.base.processes import locked_folder
from fourd.base.progress import Terminal, Track, Tracker
from fourd.cli.options import TIER_HELP, MaxMbps, PageStyles, ScenePath, check_mbps, describe, option
from fourd.cli.outputs import WRITES_WHOLE_FOLDER
from fourd.scene.files.encoding import Tier

if TYPE_CHECKING:
    from fourd.scene.packing.rate import Choice
    from fourd.scene.styles import Style


@dataclass(frozen=True)
class Arguments:
    """Writes a folder of static files: a page, a poster image, the player and the scene."""

    scene: ScenePath
    """The .4dv file to show, of any version. If fourd pack has already compressed the scene, its quality does not
    change, and --tier is ignored."""
    out: Annotated[Path, WRITES_WHOLE_FOLDER, tyro.conf.arg(aliases=["-o"])]
    """The folder to write. An earlier site in this folder is replaced."""
    tier: Annotated[Tier, describe(*TIER_HELP)] = "stream"
    title: Annotated[str | None, option("TEXT", "the name of the file")] = None
    """Title of the page."""
    url: Annotated[str | None, option("https://...", "none")] = None
    """Address at which the folder will be, so that programs that show previews of links find the poster image."""
    max_mbps: MaxMbps = None
    style: PageStyles = ()
    normals: bool = True
    """Store normals, which the page needs to draw the scene in cartoon styles. If the scene has no normals, they are
    estimated. With --no-normals, the page offers no styles."""


def run(arguments: Arguments) -> None:
    """Write the folder and print its size."""
    from fourd.viewer.publish.styles import load_styles

    check_mbps(arguments.max_mbps)
    check_url(arguments.url)
    styles = load_styles(arguments.style)
    console = Terminal(stderr=True)
    track = Tracker(console).track
    tier, level = arguments.tier, None
    if arguments.max_mbps is not None:
        choice = _choose(arguments.scene, arguments.max_mbps, track)
        tier, level = choice.tier, choice.level
        console.print(f"--max-mbps {arguments.max_mbps:g}: {choice}", soft_wrap=True)
    write_page(
        arguments.scene,
        arguments.out,
        console,
        tier,
        arguments.title,
        level=level,
        styles=styles,
        has_normals=arguments.normals,
        url=arguments.url,
    )


def check_url(url: str | None) -> None:
    """Raise UserError unless ``url`` is None or the absolute address of a web page."""
    parts = urlsplit(url or "https://x/")
    if parts.scheme not in ("http", "https") or not parts.netloc or parts.query or parts.fragment:
        raise UserError(f"--url: expected an address such as https://example.com/scene/, got '{url}'; write all of it")


def write_page(
    scene: Path,
    out: Path,
    console: Console,
    tier: Tier = "stream",
    title: str | None = None,
    *,
    level: int | None = None,
    styles: Mapping[str, Style] | None = None,
    has_normals: bool = True,
    url: str | None = None,
) -> None:
    """Write the folder of a page that plays ``scene``, and print its size. The arguments are those of
    :func:`fourd.viewer.publish.site.write_site`."""
    from fourd.viewer.publish.site import write_site

    with locked_folder(out):
        remove_unfinished_folder(out)
        write_site(
            scene,
            out,
            tier,
            title,
            Tracker(console).track,
            level=level,
            styles=styles,
            has_normals=has_normals,
            url=url,
        )
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file()) / 1e6
    line = f"{out}: {size:.1f} MB; next: {command_line('fourd', 'serve', out)}"
    console.print(line, soft_wrap=True, markup=False)


def _choose(scene: Path, max_mbps: float, track: Track) -> Choice:
    """Choose how to encode an unpacked scene: the tier (option --tier: how colours are stored and how coarsely
    values are quantised) and, within the tier, the level (set of quantisation steps). The choice is the best quality
    that a web page can play without pauses over a connection of ``max_mbps`` Mbit/s."""
    from fourd.scene.packing.rate import choose_tier
    from fourd.scene.splats.reader import open_reader

    reader = open_reader(scene)
    is_packed = reader.manifest.encoding is not None
    reader.close()
    if is_packed:
        raise UserError(
            f"--max-mbps: expected a scene that is not packed, got {scene}; run fourd pack --max-mbps on the scene "
            "from which it was packed, or leave the option out"
        )
    return choose_tier(scene, max_mbps, scene, track, for_web=True)
