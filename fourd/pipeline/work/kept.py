"""Keeps trained runs that a command with other settings would replace: ``run`` becomes ``run.1``, ``run.2`` and so on.

An imported capture that such a run reads is kept in the same way.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from fourd.base.configs import save_config
from fourd.base.errors import UserError
from fourd.base.files import UNFINISHED, resolved
from fourd.reconstruction.training.run_layout import (
    CHECKPOINTS,
    CONFIG_NAME,
    PREPARATION,
    SEGMENTS,
    checkpoint_files,
    segment_folders,
)


@dataclass(frozen=True)
class Trained:
    """A trained run.

    Attributes:
        folder: the run's folder.
        steps: step of the newest checkpoint; for a run with segments, the sum over its segments.
        nbytes: size of all its files in bytes.
    """

    folder: Path
    steps: int
    nbytes: int


def find_trained(run: Path) -> Trained | None:
    """Return the trained run in a folder, or None if the folder has no checkpoint."""
    newest = [checkpoint_files(each / CHECKPOINTS)[-1:] for each in (run, *segment_folders(run))]
    steps = [int(file.stem) for files in newest for file in files]
    return Trained(run, sum(steps), folder_size(run)) if steps else None


def folder_size(folder: Path) -> int:
    """Return the size of all files in a folder in bytes. The targets of symbolic links do not count."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_symlink() or path.is_file())


def readable_size(nbytes: int) -> str:
    """Return a number of bytes as text."""
    return f"{nbytes / 1e9:.1f} GB" if nbytes >= 1e9 else f"{nbytes / 1e6:.1f} MB"


def run_of(folder: Path) -> Path:
    """Return the run to which a folder belongs: the folder itself, or its parent if the folder holds results of the
    stages before training."""
    return folder.parent if folder.name in PREPARATION else folder


def is_segment(run: Path) -> bool:
    """Return True if a folder is the run of a segment."""
    return run.parent.name == SEGMENTS


def kept_folders(folder: Path) -> list[Path]:
    """Return the folders that were kept in place of ``folder``, such as ``run.1``, the newest first."""
    pattern = re.compile(re.escape(folder.name) + r"\.(\d+)")
    found = [(int(match[1]), path) for path in folder.parent.glob("*") if (match := pattern.fullmatch(path.name))]
    return [path for _, path in sorted(found, reverse=True)]


def next_kept(folder: Path) -> Path:
    """Return the path under which ``folder`` will be kept."""
    last = next((int(path.suffix[1:]) for path in kept_folders(folder)), 0)
    return folder.with_name(f"{folder.name}.{last + 1}")


def keep_run(run: Path, shared: Iterable[str]) -> Path:
    """Rename a run, and return its new path. The subfolders in ``shared`` stay in the old path as well: hard links to
    their files, which no stage changes in place.
    """
    target = next_kept(run)
    copy = run.with_name(f"{UNFINISHED}{run.name}")
    shutil.rmtree(copy, ignore_errors=True)
    for name in shared:
        if (run / name).is_dir():
            copy_linked(run / name, copy / name)
    os.replace(run, target)
    if copy.exists():
        os.replace(copy, run)
    return target


def bring_back(kept: Path, run: Path, capture: Path) -> None:
    """Rename the kept run ``kept`` to ``run``, which must be missing or untrained. Its config then names
    ``capture``."""
    shutil.rmtree(run, ignore_errors=True)
    os.replace(kept, run)
    for config in _configs(run):
        _set_capture(config, capture)


def readers(capture: Path, runs: Iterable[Path]) -> list[Path]:
    """Return the trained runs that read ``capture``, directly or through the links of a folder beside it."""
    places = {resolved(capture), *(resolved(link.parent) for link in _links_into(capture))}
    return [run for run in runs if find_trained(run) and any(_capture(each) in places for each in _configs(run))]


def keep_capture(capture: Path, runs: Iterable[Path]) -> Path:
    """Rename a capture, and return its new path. The configs of ``runs``, and links in folders beside it, then name the
    new path."""
    target, old = next_kept(capture), resolved(capture)
    links = [(link, Path(os.readlink(link))) for link in _links_into(capture)]
    os.replace(capture, target)
    new = resolved(target)
    for link, to in links:
        link.unlink()
        link.symlink_to(new / to.relative_to(old))
    for config in [config for run in runs for config in _configs(run)]:
        if _capture(config) == old:
            _set_capture(config, new)
    return target


def _links_into(capture: Path) -> Iterator[Path]:
    """Yield the symbolic links, in folders beside a capture, to files and folders in the capture."""
    place = resolved(capture)
    for link in capture.parent.glob("*/*"):
        if link.is_symlink() and Path(os.readlink(link)).is_relative_to(place):
            yield link


def _configs(run: Path) -> list[Path]:
    return [folder / CONFIG_NAME for folder in (run, *segment_folders(run)) if (folder / CONFIG_NAME).is_file()]


def _capture(config: Path) -> Path | None:
    """Return the capture that a config.yaml names, or None if the file is damaged."""
    # Imported here, because the module imports torch, which stages before training do not need.
    from fourd.reconstruction.training.run import load_run_config

    with suppress(UserError):
        return load_run_config(config).capture
    return None


def _set_capture(config: Path, capture: Path) -> None:
    from fourd.reconstruction.training.run import load_run_config

    content = load_run_config(config)
    if content.capture != resolved(capture):
        save_config(replace(content, capture=resolved(capture)), config)


def copy_linked(folder: Path, copy: Path) -> None:
    """Create the folder ``copy`` with hard links to the files of ``folder``. Where the file system has no hard links,
    the files are copied."""
    shutil.copytree(folder, copy, symlinks=True, copy_function=_link)


def _link(source: str, target: str) -> None:
    """Create a hard link, or copy the file if the file system has no hard links."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
