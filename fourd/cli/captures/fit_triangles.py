"""Fit a mesh to one frame of a capture by triangle splatting."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from fourd.base.errors import UserError
from fourd.base.files import remove_unfinished_file
from fourd.base.progress import Terminal, Tracker
from fourd.cli.options import CapturePath, HullAgreement, HullLeastViews, Views, option, split_names
from fourd.cli.outputs import WRITES
from fourd.reconstruction.meshes.triangle_fitting.settings import TriangleSettings
from fourd.recording.capture.layout import refuse_symlinks

if TYPE_CHECKING:
    from rich.table import Table

    from fourd.reconstruction.meshes.triangle_fitting.frame import FittedFrame

DEFAULT_SECONDS = 120.0


@dataclass(frozen=True)
class Arguments:
    """Soft triangles start on the visual hull of the mattes and are fitted to the images. During fitting, they become
    opaque and sharp-edged. Finally, they are connected to form a closed mesh with one colour per vertex."""

    capture: CapturePath
    """Capture folder with masks/ or the output of fourd matte."""
    out: Annotated[Path, WRITES, tyro.conf.arg(aliases=["-o"], metavar="FILE")]
    """Mesh to write. A .glb file is in metres, with the y axis up and an unlit material. A .ply file keeps the world
    coordinates."""
    frame: int = 0
    """Index of the frame in the capture, from 0."""
    views: Views = None
    test_views: Annotated[str | None, option("NAME,NAME", "none")] = None
    """Names of held-out cameras, separated by commas. Their images are not used to fit the mesh. The mesh is compared
    with these images, and the scores are printed."""
    scale: float = 1.0
    """Scale factor of the images. A factor of 0.5 halves width and height."""
    triangles: int = TriangleSettings.triangles
    """Maximum number of soft triangles."""
    cells: int = TriangleSettings.cells
    """Resolution of the connected mesh: number of cells along the longest side of the subject. The number of triangles
    of the mesh grows with the square of the resolution."""
    separate: bool = False
    """Keep the triangles separate instead of connecting them to form a closed mesh."""
    max_seconds: Annotated[float | None, option("SECONDS", "120 without --max-steps, else none")] = None
    """Stop after this many seconds of fitting."""
    max_steps: Annotated[int | None, option("INT", "none")] = None
    """Stop after this many steps. If the number of steps is the only limit, repeated commands write identical files."""
    agreement: HullAgreement = TriangleSettings.agreement
    least_views: HullLeastViews = TriangleSettings.least_views
    seed: int = 0
    """Random seed."""


def run(arguments: Arguments) -> None:
    """Fit the triangles, write the mesh and print the scores of held-out views."""
    from fourd.base.cameras import estimate_up
    from fourd.reconstruction.meshes.triangle_fitting.export import check_format, write_mesh
    from fourd.reconstruction.meshes.triangle_fitting.frame import fit_frame
    from fourd.reconstruction.training.cameras.selection import DataSelection, open_run_views
    from fourd.recording.capture import open_capture

    check_format(arguments.out)
    settings = _settings(arguments)
    with open_capture(arguments.capture) as capture:
        count = capture.frame_count
    if not 0 <= arguments.frame < count:
        raise UserError(f"--frame: expected 0 to {count - 1}, the frames of the capture, got {arguments.frame}")
    selection = DataSelection(
        split_names(arguments.views),
        split_names(arguments.test_views) or (),
        f"{arguments.frame}:{arguments.frame + 1}",
        arguments.scale,
    )
    views = open_run_views(arguments.capture, selection)
    refuse_symlinks(arguments.capture, arguments.out.parent)
    console = Terminal(stderr=True)
    fitted = fit_frame(views, settings, Tracker(console).track, lambda line: console.print(line, soft_wrap=True))
    remove_unfinished_file(arguments.out)
    write_mesh(arguments.out, fitted.mesh, estimate_up(views.capture.cameras))
    count = len(fitted.mesh.triangles)
    console.print(f"{arguments.out}: {count:,} triangles after {fitted.steps:,} steps", soft_wrap=True, markup=False)
    if fitted.opaque is not None:
        Terminal().print(_table(arguments, fitted))
    if fitted.is_interrupted:
        raise KeyboardInterrupt


def _settings(arguments: Arguments) -> TriangleSettings:
    has_no_limit = arguments.max_steps is None and arguments.max_seconds is None
    try:
        return TriangleSettings(
            triangles=arguments.triangles,
            cells=arguments.cells,
            connect=not arguments.separate,
            max_steps=arguments.max_steps,
            max_seconds=DEFAULT_SECONDS if has_no_limit else arguments.max_seconds,
            agreement=arguments.agreement,
            least_views=arguments.least_views,
            seed=arguments.seed,
        )
    except ValueError as error:
        field, _, message = str(error).partition(": ")
        raise UserError(f"--{field.replace('_', '-')}: {message}") from error


def _table(arguments: Arguments, fitted: FittedFrame) -> Table:
    from rich.table import Table

    table = Table(title=f"{arguments.out}: held-out views {arguments.test_views}, inside the matte's box")
    for column in ("", "PSNR dB", "SSIM"):
        table.add_column(column, justify="right" if column else "left")
    for label, evaluation in (("soft triangles", fitted.soft), ("opaque mesh", fitted.opaque)):
        if evaluation is not None and evaluation.box is not None:
            ssim = evaluation.box.ssim
            table.add_row(label, f"{evaluation.box.psnr:.2f}", "not measured" if ssim is None else f"{ssim:.4f}")
    return table
