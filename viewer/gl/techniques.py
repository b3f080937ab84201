"""Three ways to composite discs that come in the order of their depth."""

from __future__ import annotations

from typing import Protocol

import moderngl

from fourd.viewer.display import RenderRequest
from fourd.viewer.gl.arrays import Precision
from fourd.viewer.gl.discs import Discs
from fourd.viewer.gl.pictures import FullPass, Pictures, PixelCount, largest, over, replace, under

_NONE = 1e9  # as in the shaders


class Technique(Protocol):
    """Draws the discs of a request."""

    @property
    def discs(self) -> Discs:
        """Where the request's discs are to be placed."""

    def draw(self, request: RenderRequest, target: moderngl.Framebuffer) -> None:
        """Composite ``discs``, placed for the request, over its background."""

    def release(self) -> None:
        """Give back every GL object."""


class Show:
    """Shows a composited picture, which lies upside down for GL, over a request's background."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._pass = FullPass(context, "show.frag")

    def run(self, picture: moderngl.Texture, request: RenderRequest, target: moderngl.Framebuffer) -> None:
        """Into ``target``, which is left in use."""
        target.use()
        replace(self._context)
        self._pass.run({"picture": picture}, background=request.settings.background)

    def release(self) -> None:
        self._pass.release()


class Sorted:
    """One pass over what is there: every disc blended over those behind it, however many. K does not matter."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self.discs = Discs(context, {"blend": "sorted.frag"}, farthest_first=True)

    def draw(self, request: RenderRequest, target: moderngl.Framebuffer) -> None:
        target.clear(color=(*request.settings.background, 0.0))
        over(self._context)
        self.discs.draw("blend", target, upright=True)

    def release(self) -> None:
        self.discs.release()


class Peel:
    """Depth peeling (Everitt 2001), 4K4D's: a pass finds the next layer of every pixel, K times."""

    def __init__(self, context: moderngl.Context, precision: Precision) -> None:
        self._context = context
        self.discs = Discs(context, {"peel": "peel.frag"})
        short = _short(precision)
        formats = {"sum": (4, short), "layer": (4, short), "ranks 0": (1, "f4"), "ranks 1": (1, "f4")}
        self._pictures = Pictures(context, formats, depth=True)
        self._copy = FullPass(context, "copy.frag")
        self._show = Show(context)

    def draw(self, request: RenderRequest, target: moderngl.Framebuffer) -> None:
        pictures = self._pictures
        pictures.resize((request.camera.width, request.camera.height))
        pictures.clear("sum")
        pictures.clear("ranks 1")
        for layer in range(request.settings.layers):
            now, before = f"ranks {layer % 2}", f"ranks {1 - layer % 2}"
            self._next_layer(now, before)
            pictures.together(["sum"], depth=False).use()
            under(self._context)
            self._copy.run({"picture": pictures.texture("layer")})
        self._show.run(pictures.texture("sum"), request, target)

    def _next_layer(self, now: str, before: str) -> None:
        pictures = self._pictures
        pictures.clear(now, _NONE)  # where no layer is left, none comes back
        pictures.clear_depth("layer")
        replace(self._context)
        self._context.enable(moderngl.DEPTH_TEST)
        pictures.texture(before).use(0)
        self.discs.draw("peel", pictures.together(["layer", now], depth=True), peeled=0)

    def release(self) -> None:
        for item in (self._copy, self._show, self._pictures, self.discs):
            item.release()


class Dual:
    """Dual depth peeling (Bavoil and Myers 2008): a pass finds a layer from the front and one from the back.

    Of pixels with more than K layers the back is dropped, and the front peeled on while what it
    hides could be seen: the same K nearest layers as :class:`Peel`.
    """

    def __init__(self, context: moderngl.Context, precision: Precision) -> None:
        self._context = context
        self.discs = Discs(context, {"dual": "dual.frag"}, as_texture=True)
        formats = {}
        for number in range(2):
            formats[f"ends {number}"] = (2, "f4")
            formats[f"front {number}"] = formats[f"back {number}"] = (4, _short(precision))
        self._pictures = Pictures(context, formats)
        self._layers = FullPass(context, "layers.frag")
        self._unfinished = FullPass(context, "unfinished.frag")
        self._copy = FullPass(context, "copy.frag")
        self._show = Show(context)
        self._count = PixelCount()

    def draw(self, request: RenderRequest, target: moderngl.Framebuffer) -> None:
        pictures = self._pictures
        pictures.resize((request.camera.width, request.camera.height))
        pictures.clear("ends 1", 0.0, _NONE)
        pictures.clear("front 1")
        pictures.clear("back 1")
        pairs = request.settings.layers // 2
        for number in range(pairs):
            self._find(number)
            self._composite(number)
        last = self._peel_on(pairs, request.settings.layers - pairs)
        pictures.together([f"front {last % 2}"], depth=False).use()
        under(self._context)
        self._copy.run({"picture": pictures.texture(f"back {last % 2}")})
        self._show.run(pictures.texture(f"front {last % 2}"), request, target)

    def _find(self, number: int, front_only: bool = False) -> None:
        """The geometry pass of a number, from 0: the nearest and farthest ranks between those found before."""
        pictures = self._pictures
        now, before = f"ends {number % 2}", f"ends {1 - number % 2}"
        pictures.clear(now, -_NONE, -_NONE)
        pictures.texture(before).use(0)
        largest(self._context)
        self.discs.draw("dual", pictures.together([now], depth=False), ends=0, front_only=front_only)

    def _composite(self, number: int, front_only: bool = False) -> None:
        """Take in what the pass of that number has found."""
        pictures = self._pictures
        now, before = number % 2, 1 - number % 2
        pictures.together([f"front {now}", f"back {now}"], depth=False).use()
        replace(self._context)
        sources = {"ends": f"ends {now}", "front": f"front {before}", "back": f"back {before}"}
        textures = {name: pictures.texture(source) for name, source in sources.items()}
        self._layers.run({**textures, "discs": self.discs.texture}, front_only=front_only)

    def _peel_on(self, number: int, most: int) -> int:
        """From the front alone, beginning with the pass of ``number``; returns the last pass composited."""
        self._find(number)
        if not self._any_left(number, clear_back=True):
            return number - 1
        for following in range(number, number + most):
            if following > number:
                self._find(following, front_only=True)
            if not self._any_left(following, clear_back=False):
                return following - 1
            self._composite(following, front_only=True)
        return number + most - 1

    def _any_left(self, number: int, clear_back: bool) -> bool:
        """Whether a pass has found anything; if not to ``clear_back`` in those pixels, anything that could be seen."""
        pictures = self._pictures
        before = 1 - number % 2
        # What is drawn over the ends of the pass before does not matter: they are not read again.
        pictures.together([f"back {before}" if clear_back else f"ends {before}"], depth=False).use()
        replace(self._context)
        with self._count:
            self._unfinished.run(
                {"ends": pictures.texture(f"ends {number % 2}"), "front": pictures.texture(f"front {before}")},
                visible=not clear_back,
            )
        return self._count.pixels > 0

    def release(self) -> None:
        for item in (self._layers, self._unfinished, self._copy, self._count, self._show, self._pictures, self.discs):
            item.release()


def _short(precision: Precision) -> str:
    return "f2" if precision == "float16" else "f4"
