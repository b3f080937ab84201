"""Tests of stages: their keys, pickling, and the execution of their work in another process."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import shutil
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from fourd.pipeline.facts import MaskFacts
from fourd.pipeline.graphs.run import RunRequest, stages_to_scene
from fourd.pipeline.runner import AnyStage, Runner
from fourd.pipeline.stage import Artefact, Context, Leftovers, Stage
from fourd.pipeline.stages.points.carve import CarveStageSettings, carve_stage
from fourd.reconstruction.training.cameras.selection import DataSelection
from fourd.reconstruction.training.config import RefineConfig
from fourd.recording.matting.sequence import MatteSettings
from tests.training.small import full_config


@dataclass(frozen=True)
class CopyFiles:
    source: Path
    target: Path


@dataclass(frozen=True)
class CopySettings:
    suffix: str = ""


def copy(files: CopyFiles, settings: CopySettings, context: Context) -> None:
    files.target.mkdir(exist_ok=True)
    (files.target / "copy").write_text(files.source.read_text() + settings.suffix)


def copy_stage(source: Path, target: Path, suffix: str = "", after: tuple[str, ...] = ()) -> AnyStage:
    return Stage(
        target.name,
        copy,
        CopyFiles(source, target),
        CopySettings(suffix),
        inputs=(Artefact(source),),
        outputs=(target / "copy",),
        leftovers=(Leftovers(target),),
        after=after,
    )


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def run_in_process(stages: Sequence[AnyStage], context: Context) -> Iterator[AnyStage]:
    """Execute stages in a new process, as a runner for several processes would."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        for stage in stages:
            pool.submit(stage.run).result()
            yield stage


def test_every_stage_of_the_graph_pickles(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a stage that cannot be pickled and sent to another process or machine."""
    config = replace(full_config(tmp_path / "seeds.ply"), refine=RefineConfig(poses=True))
    capture = Path(shutil.copytree(ball_capture, tmp_path / "capture", ignore=shutil.ignore_patterns("masks")))
    for source in (ball_capture, capture):
        request = RunRequest(source, tmp_path / "run", config)
        stages = stages_to_scene(request, MaskFacts.read(source), MatteSettings(), tmp_path / "scene.4dv")
        assert pickle.loads(pickle.dumps(stages)) == stages
        assert len({stage.name for stage in stages}) == len(stages)
    assert [stage.name for stage in stages] == [
        "mattes", "plates", "colours", "adjust", "carve", "background", "train", "bake",
    ]  # fmt: skip


def test_a_stage_gives_the_same_result_in_another_process(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a stage whose work depends on anything other than its files and settings."""
    settings = CarveStageSettings(DataSelection(test_views=("03",)), points=500)
    Runner(Context()).run([carve_stage(ball_capture, tmp_path / "here", settings)])
    Runner(Context(), execute=run_in_process).run([carve_stage(ball_capture, tmp_path / "there", settings)])
    assert contents(tmp_path / "here") == contents(tmp_path / "there")
    assert len(contents(tmp_path / "here")) == 5


def test_a_key_depends_on_settings_files_and_earlier_stages(tmp_path: Path) -> None:
    """Catches a key that does not change if an input changes, and a key that changes although no input changes."""
    source = tmp_path / "source"
    source.write_text("a")
    stage = copy_stage(source, tmp_path / "b", after=("a", "absent"))
    key = stage.key({"a": "1"})
    assert copy_stage(source, tmp_path / "b", after=("a", "absent")).key({"a": "1"}) == key
    assert stage.key({"a": "2"}) != key
    assert copy_stage(source, tmp_path / "b", "x", after=("a", "absent")).key({"a": "1"}) != key
    os.utime(source, (1, 1))
    assert stage.key({"a": "1"}) != key


def test_links_without_a_file_have_a_fingerprint(tmp_path: Path) -> None:
    """Catches a traceback for links to missing files and for links to themselves, which downloaded captures may
    contain.
    """
    os.symlink("absent", tmp_path / "missing.yml")
    os.symlink("loop.yml", tmp_path / "loop.yml")
    os.symlink("folder", tmp_path / "folder")
    linked = Artefact(tmp_path, ("*.yml",)).fingerprint()
    assert Artefact(tmp_path / "loop.yml").fingerprint() != Artefact(tmp_path / "folder", ("*.yml",)).fingerprint()
    (tmp_path / "absent").write_text("found")
    assert Artefact(tmp_path, ("*.yml",)).fingerprint() != linked
