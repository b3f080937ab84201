"""A virtual screen (Xvfb). xdotool simulates input, and the XDND protocol drops files on windows."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

TIMEOUT_SECONDS = 60.0
"""Time limit of each wait in seconds. The limit is long, because machines that run tests may be busy."""


@dataclass(frozen=True)
class Screen:
    """A virtual screen."""

    display: str

    def environment(self) -> dict[str, str]:
        return {**os.environ, "DISPLAY": self.display, "XDG_SESSION_TYPE": "x11"}

    def xdotool(self, *words: str | int) -> str:
        """Run xdotool and return its output."""
        command = ["xdotool", *(str(word) for word in words)]
        done = subprocess.run(command, env=self.environment(), capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
        return done.stdout.strip()

    def picture(self) -> NDArray[np.uint8]:
        """An image of the whole screen, (H, W, 3) uint8."""
        from Xlib import X
        from Xlib.display import Display

        display = Display(self.display)
        try:
            root = display.screen().root
            size = root.get_geometry()
            image = root.get_image(0, 0, size.width, size.height, X.ZPixmap, 0xFFFFFFFF)
            rows = np.frombuffer(image.data, np.uint8).reshape(size.height, size.width, 4)
        finally:
            display.close()
        return np.ascontiguousarray(rows[..., 2::-1])


@contextmanager
def screen(width: int = 1280, height: int = 800, options: tuple[str, ...] = ()) -> Iterator[Screen]:
    """Start a virtual screen with additional options for Xvfb. Skip the test if Xvfb or xdotool is not installed."""
    for program in ("Xvfb", "xdotool"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    pytest.importorskip("Xlib", reason="python-xlib is not installed")
    reading, writing = os.pipe()
    server = subprocess.Popen(
        [
            "Xvfb",
            "-displayfd",
            str(writing),
            "-screen",
            "0",
            f"{width}x{height}x24",
            "-nolisten",
            "tcp",
            "-noreset",
            *options,
        ],
        pass_fds=[writing],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(writing)
    with os.fdopen(reading) as pipe:
        number = pipe.readline().strip()
    try:
        yield Screen(f":{number}")
    finally:
        server.terminate()
        server.wait()


class Viewer:
    """A process of `fourd view`, with methods that simulate the input of a user."""

    def __init__(self, screen: Screen, folder: Path, *words: str, variables: dict[str, str] | None = None) -> None:
        self.screen = screen
        self.folder = folder
        self._log = (folder / "viewer.log").open("w+")
        environment = {**screen.environment(), "XDG_STATE_HOME": str(folder / "state"), **(variables or {})}
        command = [sys.executable, "-m", "fourd.cli.main", "view", *words]
        self.process = subprocess.Popen(command, cwd=folder, env=environment, stdout=self._log, stderr=self._log)
        self.window = self.until(self._find, "a window")

    @property
    def title(self) -> str:
        return self.screen.xdotool("getwindowname", self.window)

    @property
    def log(self) -> str:
        return (self.folder / "viewer.log").read_text()

    def key(self, *names: str) -> None:
        self.screen.xdotool("key", *names)

    def drag(self, start: tuple[int, int], end: tuple[int, int], button: int = 1) -> None:
        """Press a mouse button, move the mouse in steps and release the button. The steps are slow, so that no events
        are merged."""
        self.screen.xdotool("mousemove", *start, "mousedown", button)
        for step in range(1, 6):
            position = (first + (last - first) * step // 5 for first, last in zip(start, end, strict=True))
            self.screen.xdotool("mousemove", *position, "sleep", "0.05")
        self.screen.xdotool("mouseup", button)

    def click(self, x: int, y: int) -> None:
        self.screen.xdotool(
            "mousemove", x, y, "sleep", "0.1", "mousedown", 1, "sleep", "0.1", "mouseup", 1, "sleep", "0.1"
        )

    def picture(self) -> NDArray[np.uint8]:
        return self.screen.picture()

    def keep(self, name: str) -> NDArray[np.uint8]:
        """Save an image of the screen as a PNG for inspection, and return the image."""
        picture = self.picture()
        Image.fromarray(picture).save(self.folder / f"{name}.png")
        return picture

    def until(self, found: Callable[[], object], what: str) -> str:
        """Wait until ``found()`` is true, and return its value. If the time limit passes or the viewer ends, the test
        fails and prints the viewer's log."""
        end = time.monotonic() + TIMEOUT_SECONDS
        while time.monotonic() < end:
            result = found()
            if result:
                return str(result)
            if self.process.poll() is not None:
                break
            time.sleep(0.05)
        pytest.fail(f"expected {what}; the log: {self.log} (the title: {self.title if self.window else ''})")

    def drop(self, path: Path) -> None:
        """Drop a file on the window."""
        drop_file(self.screen.display, int(self.window), path)

    def close(self) -> int:
        """Close the window and return the exit code."""
        if self.process.poll() is None:
            send_close_event(self.screen.display, int(self.window))
        try:
            return self.process.wait(TIMEOUT_SECONDS)
        finally:
            self.process.kill()
            self._log.close()

    window: str = ""

    def _find(self) -> str:
        return self.screen.xdotool("search", "--onlyvisible", "--name", "^fourd").split("\n")[0]


def set_dpi(display_name: str, dpi: int) -> None:
    """Set the screen's text resolution, as desktop environments do."""
    from Xlib import Xatom
    from Xlib.display import Display

    display = Display(display_name)
    resources = f"Xft.dpi:\t{dpi}\n".encode()
    display.screen().root.change_property(display.intern_atom("RESOURCE_MANAGER"), Xatom.STRING, 8, resources)
    display.sync()
    display.close()


def send_close_event(display_name: str, window_number: int) -> None:
    """Send the event that the close button of a window sends."""
    from Xlib.display import Display

    display = Display(display_name)
    window = display.create_resource_object("window", window_number)
    delete = display.intern_atom("WM_DELETE_WINDOW")
    _send(display, window, "WM_PROTOCOLS", [delete, 0, 0, 0, 0])
    display.sync()
    display.close()


def drop_file(display_name: str, window_number: int, path: Path) -> None:
    """Drag a file onto the window and drop it (XDND protocol, version 5)."""
    from Xlib import X
    from Xlib.display import Display
    from Xlib.protocol.event import SelectionNotify

    display = Display(display_name)
    try:
        root = display.screen().root
        source = root.create_window(0, 0, 1, 1, 0, X.CopyFromParent)
        target = display.create_resource_object("window", window_number)
        selection, uris = (display.intern_atom(name) for name in ("XdndSelection", "text/uri-list"))
        source.set_selection_owner(selection, X.CurrentTime)
        geometry = target.get_geometry()
        centre = (geometry.width // 2) << 16 | geometry.height // 2
        copy = display.intern_atom("XdndActionCopy")
        _send(display, target, "XdndEnter", [source.id, 5 << 24, uris, 0, 0])
        _send(display, target, "XdndPosition", [source.id, 0, centre, X.CurrentTime, copy])
        _send(display, target, "XdndDrop", [source.id, 0, X.CurrentTime, 0, 0])
        end = time.monotonic() + TIMEOUT_SECONDS
        finished = False
        while not finished and time.monotonic() < end:
            while not finished and display.pending_events():
                event = display.next_event()
                if event.type == X.SelectionRequest:
                    content = f"{path.as_uri()}\r\n".encode()
                    event.requestor.change_property(event.property, event.target, 8, content)
                    event.requestor.send_event(
                        SelectionNotify(
                            time=event.time,
                            requestor=event.requestor,
                            selection=event.selection,
                            target=event.target,
                            property=event.property,
                        )
                    )
                finished = event.type == X.ClientMessage and event.client_type == display.intern_atom("XdndFinished")
            display.flush()
            time.sleep(0.01)
        assert finished, "the window did not accept the file"
    finally:
        display.close()


def _send(display: Any, window: Any, kind: str, numbers: list[int]) -> None:
    from Xlib.protocol.event import ClientMessage

    window.send_event(ClientMessage(window=window, client_type=display.intern_atom(kind), data=(32, numbers)))
    display.flush()
