"""Bake a trained run into a .4dv scene that renders in real time without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from fourd.baking.bake import BAKED_LAYERS
from fourd.baking.files.encoding import Tier
from fourd.baking.packing.report import PackSettings
from fourd.cli.options import TIER_HELP, MaxMbps, RunPath, check_mbps, check_rendering, describe, option
from fourd.pipeline.runner import Runner
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.bake import BakeFiles, BakeSettings, bake_stage


@dataclass(frozen=True)
class Arguments:
    """Bakes the newest checkpoint."""

    run: RunPath
    """Run folder."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The .4dv file to write."""
    layers: int = BAKED_LAYERS
    """Number of points composited per pixel (K), 1 to 64."""
    fps: Annotated[float | None, option("FLOAT", "the recording's, or 30 if it is not known")] = None
    """Playback rate in frames per second."""
    tier: Annotated[
        Tier | None,
        describe("Write a compact file, like `fourd pack`.", *TIER_HELP),
        option("{full,stream,light}", "not packed"),
    ] = None
    max_mbps: MaxMbps = None


def run(arguments: Arguments) -> None:
    """Load the newest checkpoint and bake every frame."""
    check_rendering(arguments.layers, fps=arguments.fps)
    check_mbps(arguments.max_mbps)
    console = Console(stderr=True)
    packed = arguments.tier is not None or arguments.max_mbps is not None
    pack = PackSettings(arguments.tier or "full", arguments.max_mbps) if packed else None
    stage = bake_stage(BakeFiles(arguments.run, arguments.out), BakeSettings(arguments.layers, arguments.fps, pack))
    Runner(Context(console)).run([stage])
    size = arguments.out.stat().st_size / 2**20
    console.print(
        f"{arguments.out}: {size:.1f} MB; next: fourd render {arguments.out} --path orbit --out orbit.mp4",
        soft_wrap=True,
    )
