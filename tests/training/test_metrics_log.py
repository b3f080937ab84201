"""The metrics log after kills, resumes and write errors."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from fourd.base.errors import UserError
from fourd.reconstruction.training.metrics_log import MetricsLog


def records(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def test_records_are_flushed_at_once(tmp_path: Path) -> None:
    """Catches buffered records, which are lost if the process is killed."""
    log = MetricsLog(tmp_path / "run")
    log.scalars(10, {"psnr": 20.5, "loss/image": 1 / 3})
    assert records(tmp_path / "run") == [{"step": 10, "psnr": 20.5, "loss/image": 1 / 3}]
    log.close()
    log.close()


def test_nan_and_infinity_are_null(tmp_path: Path) -> None:
    """Catches a metrics log with NaN or Infinity, which are not valid JSON."""
    with MetricsLog(tmp_path) as log:
        log.scalars(1, {"psnr": float("inf"), "loss": float("nan"), "seconds": np.float32(2)})
    assert records(tmp_path) == [{"step": 1, "psnr": None, "loss": None, "seconds": 2.0}]


def test_resume_drops_later_steps_and_truncated_lines(tmp_path: Path) -> None:
    """Catches steps that appear twice after a resume, and a record that is appended to a truncated line."""
    with MetricsLog(tmp_path) as log:
        for step in (10, 20, 30):
            log.scalars(step, {"psnr": step})
    path = tmp_path / "metrics.jsonl"
    whole = path.read_text()
    path.write_text(whole.replace('{"step": 20', 'garbage\n[1]\n{"step": 20') + '{"step": 5, "ps')
    with MetricsLog(tmp_path, resume_step=20) as log:
        log.scalars(21, {"psnr": 21})
    assert [record["step"] for record in records(tmp_path)] == [10, 20, 21]


def test_a_last_record_without_line_end_is_dropped(tmp_path: Path) -> None:
    """Catches two records on one line. This occurs if a killed run has left a last line without a line break."""
    (tmp_path / "metrics.jsonl").write_text('{"step": 1}\n{"step": 2}')
    with MetricsLog(tmp_path, resume_step=5) as log:
        log.scalars(3, {})
    assert [record["step"] for record in records(tmp_path)] == [1, 3]


def test_tensorboard_shows_scalars_and_images_and_hides_purged_steps(tmp_path: Path) -> None:
    """Catches TensorBoard events that are not flushed, images with swapped axes, and old steps that remain after a
    resume."""
    picture = np.zeros((6, 9, 3), dtype=np.uint8)
    with MetricsLog(tmp_path) as log:
        log.scalars(10, {"psnr": 1.0})
        log.scalars(20, {"psnr": 2.0})
        log.image(10, "validation", picture)
    with MetricsLog(tmp_path, resume_step=10) as log:
        log.scalars(15, {"psnr": 3.0})
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    assert [(event.step, event.value) for event in events.Scalars("psnr")] == [(10, 1.0), (15, 3.0)]
    shown = events.Images("validation")[0]
    assert (shown.step, shown.height, shown.width) == (10, 6, 9)
    with MetricsLog(tmp_path) as log, pytest.raises(ValueError, match=r"uint8 \(H, W, 3\)"):
        log.image(1, "validation", picture.astype(np.float32))


def test_a_full_disk_is_a_user_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a traceback for a full disk instead of a one-line error that names the folder."""

    class Full:
        closed = False

        def write(self, text: str) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

    log = MetricsLog(tmp_path)
    stream = log._stream
    monkeypatch.setattr(log, "_stream", Full())
    with pytest.raises(UserError, match="No space left") as caught:
        log.scalars(1, {"psnr": 1.0})
    assert str(tmp_path) in str(caught.value)
    monkeypatch.setattr(log, "_stream", stream)
    log.close()
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="expected a writable folder"):
        MetricsLog(tmp_path / "file")
