"""Tests readers of scenes and splats with random damaged files. Readers must not crash or loop forever, and their
memory must be bounded.
"""

from __future__ import annotations

import signal
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.scene import open_scene
from fourd.scene.exporting.export import ExportSettings, Format, export_scene
from fourd.scene.files.encoding import TIERS
from fourd.scene.packing.pack import pack_scene
from tests.baking.damage import damage
from tests.baking.fuzz.mutations import SceneMutator
from tests.baking.scenes import read_frames, write_full_scene, write_scene

CASES, SLOW_CASES = 300, 10_000
BUDGET = 64 << 20
"""Maximum number of bytes that may be allocated to read a damaged scene of a few hundred points."""
HANG_SECONDS = 60


@contextmanager
def no_hang() -> Iterator[None]:
    """Fail if the ``with`` block runs for longer than a minute. Reading a file takes less than a thousandth of this
    time.
    """

    def fail(number: int, frame: FrameType | None) -> None:
        raise TimeoutError("the reader hangs")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(HANG_SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def read_all(path: Path) -> None:
    """Read all frames of a scene. UserErrors are expected, and must have one line that names the file."""
    try:
        read_frames(path, 4)
    except UserError as error:
        assert "\n" not in str(error)  # noqa: PT017
        assert path.name in str(error)  # noqa: PT017


def make_sources(folder: Path) -> list[bytes]:
    """Return small scenes of all versions and tiers, with and without a background."""
    write_scene(folder / "object.4dv", views=3, frames=2, points=40)
    write_full_scene(folder / "full.4dv", views=3, frames=2, points=40, background_points=30)
    sources = [(folder / "object.4dv").read_bytes(), (folder / "full.4dv").read_bytes()]
    for tier in TIERS:
        for name in ("object", "full"):
            pack_scene(folder / f"{name}.4dv", folder / "packed.4dv", tier)
            sources.append((folder / "packed.4dv").read_bytes())
    return sources


def fuzz_scenes(folder: Path, rng: np.random.Generator, cases: int) -> None:
    """Read ``cases`` damaged scenes. A case that fails is kept in ``folder`` as failed.4dv."""
    mutators = [SceneMutator(source, rng) for source in make_sources(folder)]
    path = folder / "failed.4dv"
    tracemalloc.start()
    try:
        for case in range(cases):
            path.write_bytes(mutators[case % len(mutators)].next())
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            with no_hang():
                read_all(path)
            used = tracemalloc.get_traced_memory()[1] - before
            assert used < BUDGET, f"case {case}: {used} bytes"
    finally:
        tracemalloc.stop()


def test_damaged_scenes_never_escape(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches exceptions other than UserError, endless loops, and memory allocated for a wrong count or size."""
    fuzz_scenes(tmp_path, rng, CASES)


@pytest.mark.slow
def test_many_damaged_scenes_never_escape(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches the errors of :func:`test_damaged_scenes_never_escape`, with more cases."""
    fuzz_scenes(tmp_path, rng, SLOW_CASES)


def fuzz_splats(folder: Path, rng: np.random.Generator, cases: int) -> None:
    """Read ``cases`` damaged files of splats in each format that fourd reads."""
    write_scene(folder / "scene.4dv", views=3, frames=1, points=30)
    formats: dict[Format, str] = {"ply-sequence": ".ply", "ply": ".ply", "splat": ".splat"}
    for name, suffix in formats.items():
        good, path = folder / f"{name}-good{suffix}", folder / f"{name}{suffix}"
        with open_scene(folder / "scene.4dv") as scene:
            export_scene(scene, good, ExportSettings(name, [0]))
        content = good.read_bytes()
        header = content.find(b"end_header") + 11
        for _ in range(cases // len(formats)):
            path.write_bytes(_damage_splats(content, header, rng))
            with no_hang():
                try:
                    with open_scene(path) as damaged:
                        damaged.frame(0)
                except UserError as error:
                    assert "\n" not in str(error)  # noqa: PT017


def _damage_splats(content: bytes, header: int, rng: np.random.Generator) -> bytes:
    """Return damaged content. In half of the cases, only the header is damaged. In the other cases, the damage can be
    anywhere in the file."""
    if header > 11 and rng.random() < 0.5:
        return damage(content[:header], rng, 4) + content[header:]
    return damage(content, rng, 20)


def test_damaged_splats_never_escape(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches exceptions other than UserError and endless loops in the readers of PLY and `.splat` files."""
    fuzz_splats(tmp_path, rng, CASES)


@pytest.mark.slow
def test_many_damaged_splats_never_escape(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches the errors of :func:`test_damaged_splats_never_escape`, with more cases."""
    fuzz_splats(tmp_path, rng, SLOW_CASES)
