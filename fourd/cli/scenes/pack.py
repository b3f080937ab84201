"""Convert a .4dv scene to a compact file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fourd.base.errors import command_line
from fourd.base.files import require_suffix
from fourd.base.progress import Terminal
from fourd.base.storage import local_copy, local_output
from fourd.cli.locations import OutLocation, SceneLocation, transfer_progress
from fourd.cli.options import TIER_HELP, MaxMbps, check_mbps, describe
from fourd.scene.files.encoding import Tier


@dataclass(frozen=True)
class Arguments:
    """Frames are quantised and compressed. Each frame can be read on its own, also over a network."""

    scene: SceneLocation
    """The .4dv file to convert, of any version, or its URL."""
    out: OutLocation
    """The .4dv file to write, or its URL."""
    tier: Annotated[Tier, describe(*TIER_HELP)] = "full"
    max_mbps: MaxMbps = None


def run(arguments: Arguments) -> None:
    """Pack the scene and print the sizes of its parts."""
    from fourd.scene.packing.report import PackSettings, pack_and_report

    check_mbps(arguments.max_mbps)
    require_suffix(arguments.out, (".4dv",), "a scene")
    console = Terminal(stderr=True)
    settings = PackSettings(arguments.tier, arguments.max_mbps)
    track = transfer_progress()
    with local_output(arguments.out, track) as out:
        with local_copy(arguments.scene, track) as scene:
            pack_and_report(scene, out, settings, console)
        size = out.stat().st_size / 1e6
    line = f"{arguments.out}: {size:.1f} MB; next: {command_line('fourd', 'view', arguments.out)}"
    console.print(line, soft_wrap=True, markup=False)
