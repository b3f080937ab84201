"""Make mattes and clean plates (images of the background without the subject) for a capture without masks, and a
contact sheet for checking the mattes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from fourd.base.errors import UserError
from fourd.base.processes import locked_folder
from fourd.base.progress import Terminal
from fourd.cli.help import RARE
from fourd.cli.options import CapturePath, SelectionOptions, Workers, option, split_names, worker_count
from fourd.cli.outputs import READS, require_distinct
from fourd.recording.capture.layout import DERIVED, MATTES, camera_names, refuse_symlinks, select_views
from fourd.recording.capture.split import read_test_views

if TYPE_CHECKING:
    from fourd.recording.matting.sequence import MatteSettings

METHOD_HELP = (
    "motion: detect the subject by motion and multi-view consistency, without a pretrained network. "
    "chroma: chroma key (green screen). rvm: Robust Video Matting, the pretrained network in the file --rvm. "
    "onnx: the network in the file --onnx. masks: masks of another program in the folder --masks. "
    "Without this option, fourd make keeps mattes whose method you chose with fourd matte."
)


@dataclass(frozen=True)
class MatteOptions:
    """How to make mattes for a capture without the folder masks/."""

    method: Annotated[
        Literal["motion", "chroma", "rvm", "onnx", "masks"] | None,
        option("{motion,chroma,rvm,onnx,masks}", "motion", METHOD_HELP),
    ] = None
    screen: Annotated[str | None, RARE, option("R,G,B", "estimated per camera")] = None
    """Colour of the screen for --method chroma, 0 to 255 per channel."""
    rvm: Annotated[Path | None, RARE, READS, option("FILE", "none")] = None
    """TorchScript file of Robust Video Matting, for --method rvm. TorchScript executes code: use only trusted files."""

    onnx: Annotated[Path | None, RARE, READS, option("FILE", "none")] = None
    """ONNX file for --method onnx: Robust Video Matting, or a network with one image input and one mask output. The
    package fourd[onnx] must be installed."""
    masks: Annotated[Path | None, RARE, READS, option("FOLDER", "none")] = None
    """Folder with CAM/FRAME.png for --method masks. The masks must be aligned with the recorded images."""
    paint: Annotated[
        tuple[str, ...],
        RARE,
        tyro.conf.arg(metavar="CAM:FRAME=FILE.png", help_behavior_hint="(repeatable)"),
        tyro.conf.UseAppendAction,
    ] = ()
    """Correct the mattes of --method motion with a painted image. Paint the subject white and the background black;
    grey and transparent pixels are unknown. The correction spreads to neighbouring frames and to the other views."""

    @property
    def is_given(self) -> bool:
        """Whether the user chose how the mattes are made."""
        return self.method is not None or bool(self.paint)

    def settings(self, seed: int) -> MatteSettings:
        """Settings of the matting stage. Raises UserError if an option belongs to a method that is not selected."""
        from fourd.recording.matting.motion.paint import parse_paint
        from fourd.recording.matting.sequence import MatteSettings

        chosen = self.method or "motion"
        for name, method in (("screen", "chroma"), ("rvm", "rvm"), ("onnx", "onnx"), ("masks", "masks")):
            if getattr(self, name) is not None and chosen != method:
                raise UserError(f"--{name}: expected --method {method}, got --method {chosen}; add --method {method}")
        if self.paint and chosen != "motion":
            raise UserError(f"--paint: expected --method motion, got --method {chosen}; edit the mattes in place")
        paint = tuple(parse_paint(text) for text in self.paint)
        return MatteSettings(chosen, seed, self.screen, self.rvm, self.onnx, self.masks, paint)


@dataclass(frozen=True)
class Arguments:
    """The command writes CAPTURE/.fourd/mattes/, CAPTURE/.fourd/plates/ and the contact sheet
    CAPTURE/.fourd/mattes.png. Run an interrupted command again to resume it.
    """

    capture: CapturePath
    """Capture folder: images/ or videos/, intri.yml and extri.yml."""
    selection: SelectionOptions
    mattes: MatteOptions
    workers: Workers = None
    seed: int = 0
    """Random seed."""
    test_views: Annotated[str | None, option("NAME,NAME|none", "the capture's test split, split.json, or none")] = None
    """Names of held-out cameras, separated by commas. Their images influence no matte of another camera.
    Name those that you hold out in fourd train."""
    plates: bool = True
    """In addition to mattes, make clean plates (images of the background without the subject)."""


def run(arguments: Arguments) -> None:
    """Make missing mattes and plates, and print their paths."""
    from fourd.pipeline.facts import MASKS, MaskFacts
    from fourd.pipeline.graphs.capture import stages_to_mattes
    from fourd.pipeline.runner import Runner
    from fourd.pipeline.stage import Context
    from fourd.pipeline.stages.mattes import MatteStageSettings
    from fourd.recording.matting.output import SHEET
    from fourd.recording.matting.plates import FOLDER as PLATES
    from fourd.recording.matting.sequence import record_choice

    capture, selection = arguments.capture, arguments.selection
    settings = MatteStageSettings(selection.names, selection.frames, arguments.mattes.settings(arguments.seed))
    context = Context(Terminal(stderr=True), worker_count(arguments.workers))
    masks = MaskFacts.read(capture)
    is_complete = not masks.lacks_masks(selection.names)
    from_hull = not arguments.mattes.is_given
    if arguments.mattes.masks is not None:
        require_distinct(capture / MATTES, [arguments.mattes.masks])
    if masks.has_masks and arguments.mattes.paint:
        raise UserError(
            f"--paint: expected a capture without {MASKS}/, got {capture / MASKS}; edit these masks instead"
        )
    refuse_symlinks(capture, capture / DERIVED)
    with locked_folder(capture / DERIVED):
        held_out = _held_out(arguments)
        Runner(context).run(
            stages_to_mattes(capture, masks, settings, arguments.plates, test_views=held_out, from_hull=from_hull)
        )
        if not masks.has_masks or (not is_complete and not from_hull):
            record_choice(capture, settings.mattes)
    lines = [f"{capture / MATTES}: mattes; {capture / SHEET} shows examples of the mattes"]
    if is_complete:
        lines = [f"{capture / MASKS}: the capture has masks, so no mattes were made"]
    elif masks.has_masks:
        lines = [f"{capture / MATTES}: mattes of the cameras without masks"]
    if arguments.plates:
        lines.append(f"{capture / PLATES}: clean plates, transparent at pixels where no frame shows the background")
    for line in lines:
        Terminal().print(line, soft_wrap=True)


def _held_out(arguments: Arguments) -> tuple[str, ...]:
    """Return the held-out cameras: those of the option, or else those of the test split that are among the selected
    cameras."""
    if arguments.test_views is None:
        split = read_test_views(arguments.capture) or ()
        chosen = select_views(arguments.selection.names, camera_names(arguments.capture)) if split else ()
        return tuple(name for name in split if name in chosen)
    return () if arguments.test_views.strip() == "none" else split_names(arguments.test_views) or ()
