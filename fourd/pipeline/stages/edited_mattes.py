"""Keeps mattes that the user has corrected by hand, when mattes with other settings replace them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fourd.base.progress import Log
from fourd.pipeline.work.kept import copy_linked, folder_size, next_kept, readable_size
from fourd.recording.capture.layout import MATTES, refuse_symlinks
from fourd.recording.matting.output import SHEET, MatteState


@contextmanager
def kept_if_edited(capture: Path, log: Log) -> Iterator[None]:
    """Print a line if the block replaces the mattes of ``capture``. If the user has edited one of them, keep all as
    ``mattes.1``, ``mattes.2`` and so on."""
    mattes, key = capture / MATTES, MatteState.read(capture).key
    exist, edited = any(mattes.glob("*/*")), _count_edited(capture)
    copy = mattes.with_name(f"{mattes.name}.copy")
    shutil.rmtree(copy, ignore_errors=True)
    if edited:
        refuse_symlinks(capture, mattes)
        copy_linked(mattes, copy)
    try:
        yield
        if exist and MatteState.read(capture).key != key:
            log(f"{mattes}: made again, because settings or files have changed")
            if edited:
                kept = next_kept(mattes)
                os.replace(copy, kept)
                log(
                    f"{mattes}: {edited} of the earlier mattes were edited after fourd had made them; all are kept as "
                    f"{kept} ({readable_size(folder_size(kept))}); delete that folder if you do not need it"
                )
    finally:
        shutil.rmtree(copy, ignore_errors=True)


def _count_edited(capture: Path) -> int:
    """Return the number of mattes that are newer than the contact sheet, which fourd writes after the mattes."""
    try:
        made_ns = (capture / SHEET).stat().st_mtime_ns
    except OSError:
        return 0
    return sum(path.lstat().st_mtime_ns > made_ns for path in (capture / MATTES).glob("*/*.png"))
