"""Tests of the runner: which stages it executes, skips and resumes, and which files it removes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from fourd.pipeline.runner import AnyStage, Runner
from fourd.pipeline.stage import Context
from tests.pipeline.test_stage import copy_stage


class Counter:
    """Executes stages and records their names. Raises KeyboardInterrupt before the work of the stage named ``stop``."""

    def __init__(self, stop: str | None = None) -> None:
        self.names: list[str] = []
        self.groups: list[list[str]] = []
        self.stop = stop

    def __call__(self, stages: Sequence[AnyStage], context: Context) -> Iterator[AnyStage]:
        self.groups.append([stage.name for stage in stages])
        for stage in stages:
            if stage.name == self.stop:
                raise KeyboardInterrupt
            self.names.append(stage.name)
            stage.run(context)
            yield stage


def run(stages: list[AnyStage], record: Path, stop: str | None = None) -> list[str]:
    """Run ``stages`` with a new runner. Returns the names of the executed stages."""
    counter = Counter(stop)
    try:
        Runner(Context(), record, counter).run(stages)
    except KeyboardInterrupt:
        assert stop is not None
    return counter.names


def chain(folder: Path, first: str = "", second: str = "") -> list[AnyStage]:
    """Two stages of which the second depends on the first, and a third stage that depends on neither."""
    source = folder / "source"
    if not source.exists():
        source.write_text("text")
    return [
        copy_stage(source, folder / "a", first),
        copy_stage(source, folder / "b", second, after=("a",)),
        copy_stage(source, folder / "c"),
    ]


def test_a_changed_setting_reruns_the_dependent_stages_only(tmp_path: Path) -> None:
    """Catches an outdated result after a change, and a stage that runs again without a change."""
    record = tmp_path / "stages.json"
    assert run(chain(tmp_path), record) == ["a", "b", "c"]
    assert run(chain(tmp_path), record) == []
    assert run(chain(tmp_path, second="x"), record) == ["b"]
    assert run(chain(tmp_path, "x", "x"), record) == ["a", "b"]
    (tmp_path / "c" / "copy").unlink()
    assert run(chain(tmp_path, "x", "x"), record) == ["c"]


def test_an_interrupted_stage_keeps_its_files_for_the_same_key_alone(tmp_path: Path) -> None:
    """Catches a resumed stage whose finished files are deleted, and files of other settings that are reused."""
    record, partial = tmp_path / "stages.json", tmp_path / "b" / "partial"
    assert run(chain(tmp_path), record, stop="b") == ["a"]
    partial.parent.mkdir()
    partial.write_text("half the work")
    assert run(chain(tmp_path), record) == ["b", "c"]
    assert partial.exists()
    assert run(chain(tmp_path, second="x"), record) == ["b"]
    assert not partial.exists()


def test_an_interrupted_stage_is_not_finished_for_an_older_key(tmp_path: Path) -> None:
    """Catches partial files that were written with new settings but are used as the result of old settings."""
    record = tmp_path / "stages.json"
    run(chain(tmp_path), record)
    assert run(chain(tmp_path, second="x"), record, stop="b") == []
    (tmp_path / "b" / "copy").write_text("partial")
    assert run(chain(tmp_path), record) == ["b"]
    assert (tmp_path / "b" / "copy").read_text() == "text"


@pytest.mark.parametrize("content", ["", "[1]", "{"])
def test_a_damaged_record_runs_all_stages(content: str, tmp_path: Path) -> None:
    """Catches a crash because of a record file that a power failure has damaged."""
    record = tmp_path / "stages.json"
    run(chain(tmp_path), record)
    record.write_text(content)
    assert run(chain(tmp_path), record) == ["a", "b", "c"]


def test_without_a_record_every_stage_is_executed_and_nothing_is_removed(tmp_path: Path) -> None:
    """Catches a runner without a record file that removes the files of an interrupted stage."""
    for _ in range(2):
        counter = Counter()
        Runner(Context(), execute=counter).run(chain(tmp_path))
        assert counter.names == ["a", "b", "c"]
        (tmp_path / "b" / "partial").write_text("")
    assert (tmp_path / "b" / "partial").exists()


def test_parallel_stages_are_executed_together(tmp_path: Path) -> None:
    """Catches stages that run before the stages that they need, and a cluster that gets one stage at a time."""
    first, second, third = chain(tmp_path)
    last = copy_stage(tmp_path / "source", tmp_path / "d")
    stages = [replace(each, is_parallel=True) for each in (third, first, second)] + [last]
    counter = Counter()
    Runner(Context(), tmp_path / "record", counter, is_parallel=True).run(stages)
    assert counter.groups == [["c", "a"], ["b"], ["d"]]
    alone = Counter()
    Runner(Context(), tmp_path / "other", alone).run(stages)
    assert alone.groups == [["c"], ["a"], ["b"], ["d"]]
