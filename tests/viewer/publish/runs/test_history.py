"""The curves of a run, read from a log that grows, is replaced, or is damaged."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from fourd.reconstruction.training.metrics_log import MetricsLog
from fourd.viewer.publish.runs import history
from fourd.viewer.publish.runs.history import RunHistory


def append(run: Path, text: str | bytes) -> None:
    with (run / "metrics.jsonl").open("ab") as stream:
        stream.write(text.encode() if isinstance(text, str) else text)


def record(step: int, **values: float | None) -> str:
    return json.dumps({"step": step, **values}) + "\n"


def test_a_log_that_grows(tmp_path: Path) -> None:
    """Catches a reader that reads lines twice, and a reader that parses an incomplete line while it is written."""
    found = RunHistory(tmp_path)
    found.update()
    assert (found.series, found.step, found.last("psnr")) == ({}, 0, None)
    append(tmp_path, record(10, psnr=20.0) + record(20, psnr=21.0)[:9])
    found.update()
    assert found.curves() == {"psnr": {"step": [10.0], "value": [20.0]}}
    append(tmp_path, record(20, psnr=21.0)[9:])
    found.update()
    found.update()
    assert found.curves() == {"psnr": {"step": [10.0, 20.0], "value": [20.0, 21.0]}}
    assert (found.broken, found.step, found.last("psnr")) == (0, 20, 21.0)


def test_a_resumed_run(tmp_path: Path) -> None:
    """Catches curves that keep the steps after the checkpoint from which a run was resumed."""
    found = RunHistory(tmp_path)
    with MetricsLog(tmp_path) as log:
        for step in (10, 20, 30):
            log.scalars(step, {"psnr": step})
        found.update()
    with MetricsLog(tmp_path, resume_step=10) as log:
        log.scalars(15, {"psnr": 5.0})
        found.update()
    assert found.curves() == {"psnr": {"step": [10.0, 15.0], "value": [10.0, 5.0]}}
    (tmp_path / "metrics.jsonl").unlink()
    found.update()
    assert found.curves() == {}


def test_damaged_lines_are_counted(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a reader that fails on a damaged line, and a reader that keeps a line of any length in memory."""
    lines: list[str | bytes] = [
        "{",
        "[1]",
        '{"psnr": 1}',
        '{"step": -1}',
        '{"step": 1.5, "psnr": 1}',
        '{"step": true}',
        '{"step": 1e400}',
        '{"step": ' + "9" * 5000 + "}",
        "[" * 10_000,
        rng.bytes(200).replace(b"\n", b""),
        "x" * 70_000,
        "x" * 200_000,
    ]
    for line in lines:
        append(tmp_path, line)
        append(tmp_path, "\n")
    append(tmp_path, record(5, psnr=30.0))
    found = RunHistory(tmp_path)
    found.update()
    assert found.broken == len(lines)
    assert found.curves() == {"psnr": {"step": [5.0], "value": [30.0]}}
    append(tmp_path, "y" * 70_000)
    found.update()
    append(tmp_path, "y" * 70_000 + "\n" + record(6, psnr=31.0))
    found.update()
    assert found.broken == len(lines) + 1
    assert found.last("psnr") == 31.0


def test_values_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    """Catches NaN in the answer, which browsers cannot parse, and names and series without a limit of their size."""
    huge = '{"step": 1, "a": 1e999, "b": NaN, "c": null, "d": "1", "e": true, "f": ' + "9" * 400 + "}\n"
    append(tmp_path, huge + record(2, **{"x" * 65: 1.0}) + record(3, **{f"s{i}": i for i in range(100)}))
    found = RunHistory(tmp_path)
    found.update()
    assert found.broken == 0
    assert sorted(found.series) == sorted(f"s{i}" for i in range(history.MAX_SERIES))


def test_a_large_log_is_read_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches an answer that waits until a log of gigabytes is read, and lines that are lost between two parts."""
    append(tmp_path, "".join(record(step, psnr=step / 7) for step in range(1, 2001)))
    found = RunHistory(tmp_path)
    monkeypatch.setattr(history, "MAX_READ_BYTES", 10_000)
    found.update()
    assert 0 < found.step < 1000
    for _ in range(20):
        found.update()
    assert (found.step, found.broken) == (2000, 0)
    assert len(found.series["psnr"].steps) == 2000


def test_long_curves_are_averaged(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches bins that lose values, and curves without detail at the start of a logarithmic axis."""
    values = rng.normal(size=20_000)
    append(tmp_path, "".join(record(10 * step, loss=float(value)) for step, value in enumerate(values, 1)))
    found = RunHistory(tmp_path)
    found.update()
    curve = found.curves()["loss"]
    steps = np.array(curve["step"])
    assert len(steps) == len(curve["value"]) <= 600
    assert np.all(np.diff(steps) > 0)
    assert np.sum(steps < 1000) > 50
    assert np.max(np.diff(steps)) < 2000
    assert curve["value"][0] == float(f"{values[0]:.7g}")


def test_a_log_that_is_no_file(tmp_path: Path) -> None:
    """Catches a server that waits for a named pipe."""
    os.mkfifo(tmp_path / "metrics.jsonl")
    found = RunHistory(tmp_path)
    found.update()
    assert found.series == {}
