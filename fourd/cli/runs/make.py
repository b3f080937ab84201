"""Make a 4D scene from videos or a capture. The stages are import, check, calibration repair, mattes, clean plates
(images of the background without the subject), carving, training and baking."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from fourd.base.errors import UserError, command_line
from fourd.base.files import resolved
from fourd.base.progress import Terminal
from fourd.base.storage import Location
from fourd.cli.captures.matte import MatteOptions
from fourd.cli.help import RARE
from fourd.cli.locations import PATH_OR_URL, OutLocation
from fourd.cli.options import (
    OFFSET_HELP,
    SOUNDTRACK_HELP,
    TIER_HELP,
    FramesPerSecond,
    Workers,
    describe,
    option,
    parse_offsets,
    worker_count,
)
from fourd.cli.outputs import READS, WRITES, WRITES_WHOLE_FOLDER
from fourd.cli.training_options import TrainingOptions
from fourd.recording.capture.frame_rate import check_rate
from fourd.scene.files.encoding import Tier

DEFAULT_SECONDS = 1800.0
RAY_DEFAULT = "none; all stages run in this process"
RAY_HELP = (
    "Run the stages as tasks of a Ray cluster, and train the segments of --segment at the same time. auto: use the "
    "cluster that runs on this machine, or start one. All nodes need the same paths on shared storage, or --work URL. "
    "Needs `pip install 'fourd[cluster]'`."
)
SOURCE_HELP = (
    "A capture, or any input of fourd import, such as a folder of videos or a session with a calibration folder. "
    "Videos without a calibration are calibrated from the recording of a calibration board beside them (board.toml "
    "and the folder board/), or else from their own images. To set the scale by hand, run fourd import first. The "
    "input can also be at a URL such as s3://bucket/videos."
)
WEB_HELP = "Folder to write, with a web page that plays the scene. `fourd serve FOLDER` shows it on this machine."
WORK_DEFAULT = "scene.work beside scene.4dv"
WORK_HELP = (
    "Folder for intermediate results, on a disk or on mounted storage, or a URL such as s3://bucket/work. With a URL, "
    "each machine works in a local copy, and publishes each finished stage. If -o is a URL, the default is scene.work "
    "in the current folder."
)
CALIBRATION_HELP = (
    "Calibration of a folder of videos: a folder with intri.yml and extri.yml, "
    "for example the output of fourd calibrate."
)


@dataclass(frozen=True)
class Arguments:
    """The command first prints the stages and the expected duration. The result of every stage is cached. Run an
    interrupted command again to resume it.
    """

    capture: tyro.conf.Positional[
        Annotated[Location, READS, PATH_OR_URL, tyro.conf.arg(metavar="VIDEOS|CAPTURE", help=SOURCE_HELP)]
    ]
    out: OutLocation
    """The .4dv file to write. Intermediate results of scene.4dv are kept in the folder scene.work/ beside the file."""
    training: TrainingOptions
    mattes: MatteOptions
    calibration: Annotated[Path | None, READS, option("FOLDER", "none", CALIBRATION_HELP)] = None
    fps: Annotated[FramesPerSecond, RARE] = None
    sync: Annotated[
        Literal["auto", "none"],
        RARE,
        describe(
            "Time offsets between videos.",
            "auto: estimate them from sound, or else from motion, and apply those of high confidence. none: the videos "
            "are synchronised.",
        ),
    ] = "auto"
    offset: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        RARE,
        tyro.conf.arg(metavar="CAM=FRAMES", help=OFFSET_HELP, help_behavior_hint="(repeatable)"),
    ] = ()
    sound: Annotated[str, option("auto|none|CAM|FILE", "auto", SOUNDTRACK_HELP)] = "auto"
    tier: Annotated[
        Literal[Tier, "none"],
        RARE,
        describe("Compression of the scene file.", *TIER_HELP, "none: plain arrays, several times larger."),
    ] = "full"
    web: Annotated[Path | None, WRITES_WHOLE_FOLDER, option("FOLDER", "none", WEB_HELP)] = None
    workers: Annotated[Workers, RARE] = None
    work: Annotated[Location | None, RARE, WRITES, PATH_OR_URL, option("FOLDER|URL", WORK_DEFAULT, WORK_HELP)] = None
    force: Annotated[bool, RARE] = False
    """Delete a trained run if this command has other settings. By default, the run is kept as scene.work/run.1,
    run.2 and so on, and used again when a later command has its settings. With --work URL, a trained run is only
    replaced with --force."""
    ray: Annotated[str | None, RARE, option("{auto,HOST:PORT}", RAY_DEFAULT, RAY_HELP)] = None
    ray_cores: Annotated[int, RARE] = 1
    """With --ray: number of cores that train each segment. All other stages use all cores of one node."""


def run(arguments: Arguments) -> None:
    """Run all stages that are not up to date."""
    from fourd.cli.scenes.web import write_page
    from fourd.cli.training_options import print_summary
    from fourd.pipeline.cluster import join_cluster
    from fourd.pipeline.make import make_scene
    from fourd.pipeline.stage import Context
    from fourd.reconstruction.training.losses.lpips import load_lpips
    from fourd.recording.importing.importer import ImportOptions
    from fourd.rendering.ops.gpu import choose_device
    from fourd.scene.packing.report import PackSettings

    # Progress is printed to stdout, because stderr is reserved for the one-line error message.
    console = Terminal()
    options = arguments.training
    check_rate(arguments.fps)
    config = options.train_config(DEFAULT_SECONDS)
    # The LPIPS weights are loaded here so that invalid weights are reported before any stage runs.
    load_lpips(options.lpips_weights)
    # Ray chooses nodes by their CPU cores only, so several segments (ranges of frames) could share the GPU of a node.
    if arguments.ray is not None and options.device == "cuda":
        raise UserError("--device, --ray: expected --device cpu or auto with --ray, got cuda; nodes use their CPUs")
    if arguments.web is not None and not isinstance(arguments.out, Path):
        raise UserError(
            f"--web: expected -o as a file on this machine, got {arguments.out}; run fourd web on the scene"
        )
    choose_device(options.device)  # A missing GPU is reported before any stage runs.
    given = None if arguments.calibration is None else str(resolved(arguments.calibration))
    with nullcontext() if arguments.ray is None else join_cluster(arguments.ray, arguments.ray_cores) as cluster:
        summary = make_scene(
            arguments.capture,
            arguments.out,
            config,
            arguments.mattes.settings(config.seed),
            Context(console, worker_count(arguments.workers), device=options.device),
            points_from=options.points_from,
            lpips_weights=options.lpips_weights,
            imports=ImportOptions(
                calibration=given,
                fps=arguments.fps,
                offsets=parse_offsets(arguments.offset),
                sync_if_possible=arguments.sync == "auto",
            ),
            pack=None if arguments.tier == "none" else PackSettings(arguments.tier),
            sound=arguments.sound,
            accept_mattes=options.accept_mattes,
            keep_chosen_mattes=not arguments.mattes.is_given,
            cluster=cluster,
            work=arguments.work,
            force=arguments.force,
        )
    print_summary(summary, console)
    if arguments.web is not None and isinstance(arguments.out, Path):
        write_page(arguments.out, arguments.web, console)
    command = command_line("fourd", "view", arguments.out)
    console.print(f"{arguments.out}: written; next: {command}", soft_wrap=True)
