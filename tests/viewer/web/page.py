"""A page with a player that tests control."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera

TIMEOUT_MS = 60_000
"""Time limit of each wait in milliseconds. The limit is long, because machines that run tests may be busy."""
IGNORED = ("ReadPixels", "Failed to load resource", "software WebGL")
"""Console messages that contain one of these texts are not errors of the player. Such messages report slow reads,
missing files and slow drivers."""
NAMES = "const player = document.querySelector('fourd-player'), {stage} = player;"
IS_READY = "player.panel && (player.firstImageMs || !player.panel.message.hidden && player.panel.message.textContent)"
"""Pages of the documentation load the player after everything else, so that the element has no panel at first."""


class PlayerPage:
    """Opens a page and runs scripts with the page's player. In the scripts, the player has the name `player`."""

    def __init__(self, page: Any, url: str) -> None:
        self.page = page
        self.problems: list[str] = []
        page.on("pageerror", self._collect_error)
        page.on("console", self._collect)
        page.goto(url)

    def leave(self) -> None:
        """Leave the page as empty as a new one."""
        self.page.evaluate("() => { try { localStorage.clear(); sessionStorage.clear(); } catch {} }")
        self.page.goto("about:blank")
        self.page.remove_listener("pageerror", self._collect_error)
        self.page.remove_listener("console", self._collect)

    def _collect_error(self, error: Any) -> None:
        self.problems.append(str(error))

    def _collect(self, message: Any) -> None:
        if not any(text in message.text for text in IGNORED):
            self.problems.append(message.text)

    def run(self, script: str, argument: Any = None) -> Any:
        """Evaluate the body of a JavaScript function, which can use the variables `player`, `stage` and `argument`."""
        return self.page.evaluate(f"async (argument) => {{ {NAMES} {script} }}", argument)

    def wait(self, condition: str) -> None:
        """Wait until a JavaScript expression, which can use `player` and `stage`, is true."""
        self.page.wait_for_function(f"() => {{ {NAMES} return {condition}; }}", timeout=TIMEOUT_MS)

    def ready(self) -> None:
        """Wait for the first image. Raises AssertionError if the page shows an error."""
        self.wait(IS_READY)
        assert self.message() == ""

    def message(self) -> str:
        """The message that the page shows, or an empty string."""
        return str(self.run("return player.panel.message.hidden ? '' : player.panel.message.textContent;"))

    def error(self) -> str:
        """Wait for an error, and return its text."""
        self.wait("!player.panel.message.hidden")
        return self.message()

    def pause(self, frame: int) -> None:
        """Pause at a frame, and wait until the page shows the frame."""
        self.ready()
        self.run("player.seek(argument); await player.settled();", frame)

    def pixels(self, camera: Camera, mode: str = "sorted") -> NDArray[np.uint8]:
        """The image (H, W, 3) of the current frame from a camera. The image has the size of the canvas."""
        described = {
            "intrinsics": camera.intrinsics.ravel().tolist(),
            "rotation": camera.rotation.ravel().tolist(),
            "translation": camera.translation.tolist(),
            "width": camera.width,
            "height": camera.height,
        }
        script = """
            stage.mode = argument.mode;
            stage.background = [0, 0, 0];
            stage.fixedCamera = argument.camera;
            stage.isDirty = true;
            await player.settled();
            stage.redraw();
            const pixels = stage.renderer.readPixels();
            return btoa(Array.from(pixels, (byte) => String.fromCharCode(byte)).join(""));
        """
        content = base64.b64decode(self.run(script, {"camera": described, "mode": mode}))
        return np.frombuffer(content, np.uint8).reshape(camera.height, camera.width, 4)[..., :3]
