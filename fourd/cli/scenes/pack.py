"""Convert a .4dv scene to a compact file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from fourd.baking.files.encoding import Tier
from fourd.baking.packing.report import PackSettings, pack_and_report
from fourd.cli.options import TIER_HELP, MaxMbps, ScenePath, check_mbps, describe
from fourd.progress import Terminal


@dataclass(frozen=True)
class Arguments:
    """Frames are quantised and compressed. Every frame can be read separately, also over a network."""

    scene: ScenePath
    """The .4dv file to convert, of any version."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The .4dv file to write."""
    tier: Annotated[Tier, describe(*TIER_HELP)] = "full"
    max_mbps: MaxMbps = None


def run(arguments: Arguments) -> None:
    """Pack the scene and print the sizes of its parts."""
    check_mbps(arguments.max_mbps)
    console = Terminal(stderr=True)
    settings = PackSettings(arguments.tier, arguments.max_mbps)
    pack_and_report(arguments.scene, arguments.out, settings, console)
    size = arguments.out.stat().st_size / 1e6
    line = f"{arguments.out}: {size:.1f} MB; next: fourd view {arguments.out}"
    console.print(line, soft_wrap=True, markup=False)
