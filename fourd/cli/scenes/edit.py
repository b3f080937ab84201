"""Edit a .4dv scene: keep a part of it, move it, change its colours, or add another scene."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from fourd.base.errors import UserError, command_line
from fourd.base.files import require_suffix
from fourd.base.progress import Terminal, Tracker, console_log
from fourd.base.storage import local_copy, local_output
from fourd.cli.locations import OutLocation, SceneLocation, transfer_progress
from fourd.cli.options import TIER_HELP, describe, option
from fourd.cli.outputs import READS
from fourd.scene.files.encoding import Tier

if TYPE_CHECKING:
    from fourd.scene.editing.edit import Edits

SCRATCH = ".edit"
"""Name of a temporary folder beside the output, for the edited scene before it is packed."""
FLOATER_SHARE = 0.02
MAX_FACTOR = 1e6
MAX_LENGTH = 1e9
NO_BACKGROUND = Path("none")


@dataclass(frozen=True)
class Arguments:
    """Lengths and positions are in metres if the scene states the length of its world unit (see fourd info), and else
    in world units. Edits are applied in the order of the list below. To apply them in another order, call the command
    again. Memory does not grow with the number of frames.
    """

    scene: SceneLocation
    """The .4dv file to edit, of any version, or its URL."""
    out: OutLocation
    """The .4dv file to write, or its URL."""
    trim: Annotated[str | None, option("A:B[:S]", "all")] = None
    """Keep every S-th frame from A to B - 1, counted from 0."""
    crop: Annotated[
        tuple[str, ...],
        tyro.conf.arg(metavar="REGION", help_behavior_hint="(repeatable)"),
        tyro.conf.UseAppendAction,
        describe(
            "Keep the points in this region: box=X0,Y0,Z0,X1,Y1,Z1, or cylinder=RADIUS around the middle of the",
            "subject, or cylinder=RADIUS,X,Y,Z around a position, with an axis that points up, or above-floor, or",
            "above-floor=HEIGHT, as measured from the feet of the subject. With several regions, points are kept that",
            "are in all of them.",
        ),
    ] = ()
    remove_floaters: bool = False
    """Remove small groups of points that hang in the air, apart from the subject."""
    floater_share: float = FLOATER_SHARE
    """With --remove-floaters: groups with fewer points than this share of the largest group are removed, in (0, 1]."""
    brightness: float = 1.0
    """Factor of all colours. Colours are clipped at white."""
    colour: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="R G B")] = (1.0, 1.0, 1.0)
    """Factors of red, green and blue."""
    metres: bool = False
    """Scale the coordinates so that a world unit is a metre, if the length of the world unit is known."""
    scale: float = 1.0
    """Factor of all lengths."""
    up: Annotated[Literal["x", "-x", "y", "-y", "z", "-z"] | None, option("{x,-x,y,-y,z,-z}", "as it is")] = None
    """Turn the scene so that its up direction becomes this axis: y for most programs, z for Blender."""
    floor_to_zero: bool = False
    """Move the scene along its up direction so that the floor, under the feet of the subject, is at 0."""
    turn: float = 0.0
    """Turn the scene about its up direction, counterclockwise as seen from above, in degrees."""
    move: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Move the scene."""
    merge: Annotated[Path | None, READS, option("OTHER.4dv", "none")] = None
    """Add the subject of another scene, at the same time after the first frame. If it is shorter, it repeats."""
    at: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """With --merge: move the other scene."""
    at_turn: float = 0.0
    """With --merge: turn the other scene about its up direction before it is moved, in degrees."""
    background: Annotated[Path | None, READS, option("none|OTHER.4dv", "as it is")] = None
    """none removes the surroundings of a whole scene; OTHER.4dv replaces them by those of another scene."""
    speed: float = 1.0
    """Factor of the frame rate."""
    tier: Annotated[Tier | None, describe(*TIER_HELP), option("{full,stream,video,light}", "as the scene")] = None


def run(arguments: Arguments) -> None:
    """Check the options, write the edited scene, and print what changed."""
    from fourd.reconstruction.training.points.scratch import Scratch
    from fourd.scene.editing.edit import edit_scene

    _check(arguments)
    require_suffix(arguments.out, (".4dv",), "a scene")
    console = Terminal(stderr=True)
    track, edits = transfer_progress(), _edits(arguments)
    with local_output(arguments.out, track) as out:
        out.parent.mkdir(parents=True, exist_ok=True)
        with local_copy(arguments.scene, track) as scene, closing(Scratch(out.parent / SCRATCH)) as scratch:
            tracker = Tracker(console).track
            report = edit_scene(scene, out, edits, arguments.tier, scratch.folder, tracker, console_log(console))
        size = out.stat().st_size / 1e6
    console.print(
        f"{report.frames} of {report.frames_before} frames; {report.points:,.0f} points a frame, before "
        f"{report.points_before:,.0f}",
        soft_wrap=True,
    )
    line = f"{arguments.out}: {size:.1f} MB; next: {command_line('fourd', 'view', arguments.out)}"
    console.print(line, soft_wrap=True, markup=False)


def _edits(arguments: Arguments) -> Edits:
    from fourd.scene.editing.edit import Edits, Placement

    place = Placement(
        arguments.metres,
        arguments.scale,
        arguments.up,
        arguments.floor_to_zero,
        arguments.turn,
        arguments.move,
    )
    red, green, blue = (arguments.brightness * factor for factor in arguments.colour)
    is_bare = arguments.background == NO_BACKGROUND
    return Edits(
        trim=arguments.trim,
        crops=arguments.crop,
        floater_share=arguments.floater_share if arguments.remove_floaters else None,
        gains=(red, green, blue),
        placement=place,
        merge=arguments.merge,
        merge_at=Placement(turn_degrees=arguments.at_turn, move=arguments.at),
        background=None if is_bare else arguments.background,
        has_background=arguments.background is None,
        speed=arguments.speed,
    )


def _check(arguments: Arguments) -> None:
    """Raise UserError for values out of range, and for options that would have no effect."""
    factors = (
        ("brightness", arguments.brightness),
        ("scale", arguments.scale),
        ("speed", arguments.speed),
        *(("colour", factor) for factor in arguments.colour),
    )
    for name, factor in factors:
        if not 1 / MAX_FACTOR <= factor <= MAX_FACTOR:
            raise UserError(f"--{name}: expected a factor from {1 / MAX_FACTOR:g} to {MAX_FACTOR:g}, got {factor:g}")
    lengths = (*arguments.move, *arguments.at, arguments.turn, arguments.at_turn)
    if not all(abs(value) <= MAX_LENGTH for value in lengths):
        raise UserError(f"--move, --turn, --at, --at-turn: expected numbers up to {MAX_LENGTH:g}, got {lengths}")
    if not 0 < arguments.floater_share <= 1:
        raise UserError(f"--floater-share: expected a share in (0, 1], got {arguments.floater_share:g}")
    if arguments.floater_share != FLOATER_SHARE and not arguments.remove_floaters:
        raise UserError("--floater-share: expected also --remove-floaters, got only --floater-share; add it")
    if arguments.merge is None and (any(arguments.at) or arguments.at_turn):
        raise UserError("--at, --at-turn: expected also --merge, got none; name the other scene with --merge")
    if arguments == replace(Arguments(arguments.scene, arguments.out), tier=arguments.tier):
        raise UserError("expected at least one edit, such as --trim 0:24, got none; see fourd edit --help")
