"""Three ways to composite discs that come in the order of their depth."""

from __future__ import annotations

from typing import Protocol

import moderngl

from fourd.viewer.gl.arrays import Precision
from fourd.viewer.gl.discs import Discs
from fourd.viewer.gl.pictures import FullPass, Pictures, largest, over, replace, under
from fourd.viewer.look import Shot

_NONE = 1e9  # as in the shaders


class Technique(Protocol):
    """Draws the discs of a shot."""

    @property
    def discs(self) -> Discs:
        """Where the shot's discs are to be placed."""

    def draw(self, shot: Shot, target: moderngl.Framebuffer) -> None:
        """Composite ``discs``, placed for the shot, over its background."""

    def release(self) -> None:
        """Give back every GL object."""


class Sorted:
    """One pass over what is there: every disc blended over those behind it, however many. K does not matter."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self.discs = Discs(context, {"blend": "sorted.frag"}, farthest_first=True)

    def draw(self, shot: Shot, target: moderngl.Framebuffer) -> None:
        target.clear(color=(*shot.look.background, 0.0))
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
        self._show = FullPass(context, "show.frag")

    def draw(self, shot: Shot, target: moderngl.Framebuffer) -> None:
        pictures = self._pictures
        pictures.resize((shot.camera.width, shot.camera.height))
        pictures.clear("sum")
        pictures.clear("ranks 1")
        for layer in range(shot.look.layers):
            now, before = f"ranks {layer % 2}", f"ranks {1 - layer % 2}"
            self._next_layer(now, before)
            pictures.together(["sum"], depth=False).use()
            under(self._context)
            self._copy.run({"picture": pictures.texture("layer")})
        target.use()
        replace(self._context)
        self._show.run({"picture": pictures.texture("sum")}, background=shot.look.background)

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
        self.discs = Discs(context, {"dual": "dual.frag"})
        short = _short(precision)
        formats = {"sum": (4, short), "behind": (4, short), "back": (4, short)}
        for number in range(2):
            formats.update({f"ends {number}": (2, "f4"), f"front {number}": (4, short)})
        self._pictures = Pictures(context, formats)
        self._copy = FullPass(context, "copy.frag")
        self._unfinished = FullPass(context, "unfinished.frag")
        self._join = FullPass(context, "join.frag")
        self._show = FullPass(context, "show.frag")
        self._query = context.query(samples=True)

    def draw(self, shot: Shot, target: moderngl.Framebuffer) -> None:
        pictures, manifest = self._pictures, shot.manifest
        pictures.resize((shot.camera.width, shot.camera.height))
        pictures.clear("behind")
        pictures.clear("ends 1", 0.0, _NONE)
        pictures.clear("front 1")
        shift = max(0.0, manifest.sh_range - manifest.sh_base)  # no colour is more negative than this
        pairs = shot.look.layers // 2
        for number in range(pairs + 1):  # the first pass finds both ends alone
            self._next_layers(number, shift)
            if number > 0:
                self._put_before_the_back()
        last = self._peel_on(pairs + 1, shot.look.layers - pairs, shift)
        pictures.together(["sum"], depth=False).use()
        replace(self._context)
        self._join.run(
            {"front": pictures.texture(f"front {last % 2}"), "back": pictures.texture("behind")}, shift=shift
        )
        target.use()
        replace(self._context)
        self._show.run({"picture": pictures.texture("sum")}, background=shot.look.background)

    def _next_layers(self, number: int, shift: float, front_only: bool = False) -> None:
        pictures = self._pictures
        now, before = number % 2, 1 - number % 2
        pictures.clear(f"ends {now}", -_NONE, -_NONE)
        pictures.clear(f"front {now}")
        pictures.clear("back")
        pictures.texture(f"ends {before}").use(0)
        pictures.texture(f"front {before}").use(1)
        largest(self._context)
        drawn = pictures.together([f"ends {now}", f"front {now}", "back"], depth=False)
        self.discs.draw("dual", drawn, ends=0, front=1, shift=shift, front_only=front_only)

    def _put_before_the_back(self) -> None:
        self._pictures.together(["behind"], depth=False).use()
        over(self._context)
        self._copy.run({"picture": self._pictures.texture("back")})

    def _peel_on(self, number: int, most: int, shift: float) -> int:
        """From the front alone, for at most ``most`` passes; returns the number of the last pass."""
        last = number - 1
        if not self._any_left(last, "behind", visible=False):
            return last
        for _ in range(most):
            if not self._any_left(last, "back", visible=True):
                break
            last += 1
            self._next_layers(last, shift, front_only=True)
        return last

    def _any_left(self, number: int, cleared: str, visible: bool) -> bool:
        """Whether pixels have layers left after a pass; ``cleared`` is set to 0 in those."""
        pictures = self._pictures
        pictures.together([cleared], depth=False).use()
        replace(self._context)
        with self._query:
            self._unfinished.run(
                {"ends": pictures.texture(f"ends {number % 2}"), "front": pictures.texture(f"front {number % 2}")},
                visible=visible,
            )
        return bool(self._query.samples)

    def release(self) -> None:
        for item in (self._copy, self._unfinished, self._join, self._show, self._pictures, self.discs):
            item.release()


def _short(precision: Precision) -> str:
    return "f2" if precision == "float16" else "f4"
