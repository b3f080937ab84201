"""Functions that the tests call in a child process."""

from __future__ import annotations

import ctypes
import os
import time
from pathlib import Path

import numpy as np

from fourd.base.errors import UserError


def read(path: str, suffix: str) -> tuple[dict[str, object], bytes]:
    print("a line of a library that must not be part of the reply", flush=True)
    return {"name": Path(path).name + suffix, "number": float("inf"), "process": os.getpid()}, Path(path).read_bytes()


def refuse(path: str) -> None:
    raise UserError(f"{path}: expected\x1b[2J a parser, got none; fix it")


def crash(path: str) -> None:
    ctypes.string_at(0)


def spin(path: str) -> None:
    while True:
        pass


def take_memory(path: str) -> int:
    return int(np.ones(1 << 30).sum())


def fail(path: str) -> None:
    raise KeyError(path)


def sleep(path: str) -> None:
    time.sleep(60)
