"""The widget that plays a scene in a notebook. It needs the packages of the extra ``fourd[notebook]``."""

from __future__ import annotations

import base64
import html
from importlib.resources import as_file, files
from typing import Any

import anywidget
import traitlets

from fourd.base.errors import UserError
from fourd.viewer.notebook.bundle import bundle
from fourd.viewer.notebook.served import ServedScene
from fourd.viewer.publish.styles import STYLES_NAME, encode_styles, load_styles

MAX_EMBEDDED = 64 << 20
"""Maximum size in bytes of a scene that becomes a part of a notebook."""


class SceneWidget(anywidget.AnyWidget):
    """A player in the output of a cell. :func:`fourd.show` makes it.

    The page reads the parts of the scene that it needs from the kernel, and keeps only these in memory. Programs can
    set the traits ``frame`` (index of the frame to pause at), ``height`` (in CSS pixels) and ``background`` (a colour
    such as "#203040", or None).

    Without scripts, or without a kernel that has the widget, notebooks show a picture of the first frame.
    """

    _esm = traitlets.Unicode().tag(sync=True)
    name = traitlets.Unicode(read_only=True).tag(sync=True)
    size = traitlets.Int(read_only=True).tag(sync=True)
    poster = traitlets.Bytes(read_only=True).tag(sync=True)
    scene = traitlets.Bytes(None, allow_none=True, read_only=True).tag(sync=True)
    autoplay = traitlets.Bool(read_only=True).tag(sync=True)
    frame = traitlets.Int(None, allow_none=True).tag(sync=True)
    height = traitlets.Int(480).tag(sync=True)
    background = traitlets.Unicode(None, allow_none=True).tag(sync=True)

    def __init__(
        self, served: ServedScene, *, height: int, autoplay: bool, background: str | None, embed: bool
    ) -> None:
        """Raises UserError if the scene is to be embedded and is too large."""
        self._served = served
        if embed and served.size > MAX_EMBEDDED:
            limit, got = MAX_EMBEDDED >> 20, served.size / 2**20
            fix = 'leave out embed, or use fewer frames or tier="light"'
            raise UserError(f"embed: expected a scene of at most {limit} MB, got {got:.0f} MB; {fix}")
        self.set_trait("name", served.name)
        self.set_trait("size", served.size)
        self.set_trait("poster", served.poster)
        self.set_trait("autoplay", autoplay)
        if embed:
            self.set_trait("scene", served.path.read_bytes())
        super().__init__(_esm=player_module(), height=height, background=background)
        self.on_msg(self._answer)

    def close(self) -> None:
        """Remove the widget from all pages, and the temporary file of its scene."""
        super().close()
        self._served.close()

    def _answer(self, widget: SceneWidget, content: Any, buffers: Any) -> None:
        """Send the page the range of the scene that it asks for."""
        if not isinstance(content, dict) or not isinstance(content.get("id"), str):
            return
        try:
            part = self._served.read(content.get("offset"), content.get("size"))
        except UserError as error:
            self.send({"id": content["id"], "error": str(error)})
            return
        self.send({"id": content["id"]}, [part])

    def _repr_mimebundle_(self, **options: Any) -> tuple[dict[str, Any], dict[str, Any]] | None:
        made = super()._repr_mimebundle_(**options)
        if made is None:
            return None
        data, metadata = made
        picture = base64.b64encode(self._served.poster).decode("ascii")
        name = html.escape(self._served.name, quote=True)
        fallback = f'<img src="data:image/png;base64,{picture}" alt="First frame of {name}">'
        text = f"<SceneWidget {self._served.name}>"
        return {**data, "image/png": picture, "text/html": fallback, "text/plain": text}, metadata


def player_module() -> str:
    """Return the JavaScript of the widget: the player and the styles that it offers, as one module."""
    with as_file(files("fourd.viewer") / "web") as web:
        return bundle(web, "notebook/widget.js", "widget", {STYLES_NAME: encode_styles(load_styles(()))})
