"""The stage that corrects a calibration."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from fourd.pipeline.stage import Context
from fourd.pipeline.stages.cameras.repair import repair_stage, repaired_capture
from fourd.recording.calibration.perturbation import perturb_cameras
from fourd.recording.capture import open_capture
from tests.calibration.rooms import room_cameras
from tests.cli.test_import import write_room


def test_a_wrong_calibration_is_corrected_in_a_linked_capture(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a correction that changes the user's files, and a message that does not state the residuals before and
    after the correction.
    """
    true = room_cameras(4, 320, 240)
    names = list("abcd")
    wrong = perturb_cameras(dict(zip(names, true, strict=True)), 1.0, 0.02, rng)
    source = write_room(tmp_path / "source", names, true, list(wrong.values()))
    before = (source / "extri.yml").read_text()
    text = io.StringIO()
    context = Context(Console(file=text, width=300))
    repair_stage(source, tmp_path / "repaired").run(context)
    assert (source / "extri.yml").read_text() == before
    found = repaired_capture(source, tmp_path / "repaired")
    assert found == tmp_path / "repaired"
    assert (found / "images").resolve() == source / "images"
    log = text.getvalue()
    assert "calibration: before median " in log
    assert "; after median " in log
    assert "poses: median" in log
    corrected, given = open_capture(found).cameras, open_capture(source).cameras
    assert not np.allclose(corrected[0].rotation, given[0].rotation, atol=1e-4)

    good = write_room(tmp_path / "good", names, true, [replace(camera) for camera in true])
    repair_stage(good, tmp_path / "unneeded").run(context)
    assert repaired_capture(good, tmp_path / "unneeded") == good
    assert "no correction is needed" in text.getvalue()
