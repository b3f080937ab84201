"""Everything that a capture without masks needs before carving: mattes, plates, and a sheet to judge them by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.capture import open_capture
from fourd.capture.layout import MATTES, camera_folders
from fourd.capture.video_index import index_capture
from fourd.matting.contact_sheet import contact_sheet
from fourd.matting.plates import FOLDER as PLATES
from fourd.matting.plates import make_plates
from fourd.matting.selection import Selection
from fourd.matting.stage import SHEET, MatteSettings, make_mattes, matte_key
from fourd.progress import Track


@dataclass(frozen=True)
class Made:
    """What there is now.

    Attributes:
        brought: whether the capture has masks/ of its own, which are used and not touched.
        frames: number of frames whose mattes were made now.
        mattes: folder of the mattes.
        sheet: contact sheet.
        plates: folder of the plates; None where none were asked for.
    """

    brought: bool
    frames: int
    mattes: Path
    sheet: Path
    plates: Path | None


def make_all(selection: Selection, settings: MatteSettings, workers: int, track: Track, plates: bool) -> Made:
    """Make mattes unless the capture has its own, then plates, then the sheet; what is done is kept.

    Raises:
        UserError: as :func:`fourd.matting.stage.make_mattes`.
    """
    path = selection.path
    index_capture(path, selection.views, track)
    brought = bool(camera_folders(path / "masks"))
    frames = 0 if brought else make_mattes(selection, settings, workers, track)
    capture = open_capture(path, views=selection.views, frames=selection.frames)
    sheet = path / SHEET
    if not brought and (frames or not sheet.exists()):
        contact_sheet(capture, sheet, track=track)
    if plates:
        make_plates(selection, matte_key(capture, settings), workers, track)
    return Made(brought, frames, path / MATTES, sheet, path / PLATES if plates else None)
