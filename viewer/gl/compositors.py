"""Three methods to composite depth-sorted discs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import moderngl
from OpenGL import GL

from fourd.viewer.display import RenderRequest
from fourd.viewer.gl.discs import Discs
from fourd.viewer.gl.frame_textures import Precision
from fourd.viewer.gl.image_region import ImageRegion
from fourd.viewer.gl.passes import (
    FullScreenPass,
    RenderTargets,
    SampleCounter,
    blend_max,
    blend_over,
    blend_under,
    disable_blending,
)
from fourd.viewer.gl.shaders import NONE


class Compositor(Protocol):
    """Composites the discs of a render request."""

    @property
    def discs(self) -> Discs:
        """The disc geometry. The caller must call :meth:`Discs.project` before :meth:`draw`."""

    def draw(self, request: RenderRequest, target: moderngl.Framebuffer, is_picture: bool = True) -> None:
        """Composite :attr:`discs`, and write the result upright into ``target``.

        If ``is_picture`` is True, the result is composited over the background colour of the request, filtered with the
        pixel filter and clamped to [0, 1]. If ``is_picture`` is False, the result is the premultiplied quantity that
        the discs show (colour, normal or depth) with its alpha. It is neither filtered nor clamped.
        """

    def release(self) -> None:
        """Free all GL objects."""


class OverBackground:
    """Draws a composited image over the background colour, with the scene's pixel filter. Row 0 of the image's texture
    is the top of the image."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._pass = FullScreenPass(context, "over_background.frag")
        self._pixel_filter = PixelFilter(context)

    def run(
        self,
        image: moderngl.Texture,
        request: RenderRequest,
        target: moderngl.Framebuffer,
        is_picture: bool,
        region: ImageRegion,
    ) -> None:
        """Draw ``image`` into ``target`` as :meth:`Compositor.draw` does. The framebuffer ``target`` stays bound.

        The image is empty outside ``region``. If ``is_picture`` is True, ``target`` is therefore filled with the
        background colour, and the image is drawn only inside ``region``.
        """
        if not is_picture:
            self.copy(image, target)
            return
        background = request.settings.background
        target.clear(color=(*background, 0.0))
        if region.is_empty:
            return
        disable_blending(self._context)
        with _upright_viewport(target, region):
            self._pass.run({"image": image}, is_picture=True, background=background)
        self._pixel_filter.run(request, target, region)

    def copy(self, image: moderngl.Texture, target: moderngl.Framebuffer) -> None:
        """Copy ``image`` into ``target`` without a background or a filter. The framebuffer ``target`` stays bound."""
        target.use()
        disable_blending(self._context)
        self._pass.run({"image": image}, is_picture=False, background=(0.0, 0.0, 0.0))

    def release(self) -> None:
        """Free all GL objects."""
        self._pass.release()
        self._pixel_filter.release()


class PixelFilter:
    """Applies the scene's pixel filter to a picture."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._pass = FullScreenPass(context, "pixel_filter.frag")
        self._unfiltered: moderngl.Texture | None = None

    def run(self, request: RenderRequest, target: moderngl.Framebuffer, region: ImageRegion) -> None:
        """Filter the upright picture in ``target``, which has one texture. The framebuffer ``target`` stays bound.

        Outside ``region``, the picture has one colour, so the picture is filtered only inside.
        """
        if request.manifest.pixel_filter == 0 or region.is_empty:
            return
        width, height = target.size
        # The picture is copied into a texture of the same format, because drivers copy faster than a shader pass draws.
        unfiltered = self._texture_like(target)
        left, right = max(region.left - 1, 0), min(region.right + 1, width)  # The filter reads the neighbours, too.
        bottom, top = max(height - region.bottom - 1, 0), min(height - region.top + 1, height)
        target.use()
        unfiltered.use(0)
        GL.glCopyTexSubImage2D(GL.GL_TEXTURE_2D, 0, left, bottom, left, bottom, right - left, top - bottom)
        disable_blending(self._context)
        with _upright_viewport(target, region):
            self._pass.run({"image": unfiltered}, pixel_filter=request.manifest.pixel_filter)

    def _texture_like(self, target: moderngl.Framebuffer) -> moderngl.Texture:
        """Return a texture with the size and the format of the texture of ``target``."""
        picture = target.color_attachments[0]
        assert isinstance(picture, moderngl.Texture)
        kept = self._unfiltered
        if kept is None or (kept.size, kept.dtype) != (picture.size, picture.dtype):
            self._release_texture()
            self._unfiltered = kept = self._context.texture(picture.size, picture.components, dtype=picture.dtype)
            kept.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return kept

    def _release_texture(self) -> None:
        if self._unfiltered is not None:
            self._unfiltered.release()
            self._unfiltered = None

    def release(self) -> None:
        """Free all GL objects."""
        self._release_texture()
        self._pass.release()


class SortedBlending:
    """Blends all discs in one pass, from the farthest to the nearest. The request's maximum number of layers K is
    ignored."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self.discs = Discs(context, {"blend": "sorted.frag"}, farthest_first=True)
        self._pixel_filter = PixelFilter(context)

    def draw(self, request: RenderRequest, target: moderngl.Framebuffer, is_picture: bool = True) -> None:
        """See :meth:`Compositor.draw`."""
        background = request.settings.background if is_picture else (0.0, 0.0, 0.0)
        target.clear(color=(*background, 0.0))
        blend_over(self._context)
        self.discs.draw("blend", target, upright=True)
        if is_picture:
            self._pixel_filter.run(request, target, self.discs.region)

    def release(self) -> None:
        """Free all GL objects."""
        for item in (self._pixel_filter, self.discs):
            item.release()


class DepthPeeling:
    """Depth peeling (Everitt 2001), as in 4K4D. Each of the K passes finds the next depth layer of every pixel, where K
    is the maximum number of layers."""

    def __init__(self, context: moderngl.Context, precision: Precision) -> None:
        self._context = context
        self.discs = Discs(context, {"peel": "peel.frag"})
        short = _short_dtype(precision)
        formats = {"sum": (4, short), "layer": (4, short), "ranks 0": (1, "f4"), "ranks 1": (1, "f4")}
        self._targets = RenderTargets(context, formats, has_depth=True)
        self._copy = FullScreenPass(context, "copy.frag.js")
        self._over_background = OverBackground(context)

    def draw(self, request: RenderRequest, target: moderngl.Framebuffer, is_picture: bool = True) -> None:
        """See :meth:`Compositor.draw`."""
        targets = self._targets
        targets.resize((request.camera.width, request.camera.height))
        targets.clear("sum")
        targets.clear("ranks 1")
        for layer in range(request.settings.layers):
            self._peel_layer(f"ranks {layer % 2}", f"ranks {1 - layer % 2}")
            targets.framebuffer(["sum"]).use()
            blend_under(self._context)
            self._copy.run({"image": targets.texture("layer")})
        self._over_background.run(targets.texture("sum"), request, target, is_picture, self.discs.region)

    def _peel_layer(self, ranks: str, previous_ranks: str) -> None:
        targets = self._targets
        targets.clear(ranks, NONE)  # pixels without a layer keep NONE, so later passes find no layer
        targets.clear_with_depth("layer")
        disable_blending(self._context)
        self._context.enable(moderngl.DEPTH_TEST)
        targets.texture(previous_ranks).use(0)
        self.discs.draw("peel", targets.framebuffer(["layer", ranks], with_depth=True), peeled_rank=0)

    def release(self) -> None:
        """Free all GL objects."""
        for item in (self._copy, self._over_background, self._targets, self.discs):
            item.release()


class DualDepthPeeling:
    """Dual depth peeling (Bavoil and Myers 2008): in each pixel, a pass finds the nearest and the farthest of the
    remaining layers.

    Let K be the maximum number of composited layers. The first K // 2 passes each find up to two layers per pixel. If
    layers remain in a pixel after these passes, the layers peeled from its back are dropped, because they may not be
    among the K nearest. Further passes then peel layers from the front until K layers are composited or no further
    layer is visible. The result has the K nearest layers, as in :class:`DepthPeeling`.
    """

    def __init__(self, context: moderngl.Context, precision: Precision) -> None:
        self._context = context
        self.discs = Discs(context, {"peel": "dual_peel.frag"}, as_texture=True)
        formats = {}
        for parity in range(2):
            formats[f"bounds {parity}"] = (2, "f4")
            formats[f"front {parity}"] = formats[f"back {parity}"] = (4, _short_dtype(precision))
        self._targets = RenderTargets(context, formats)
        self._composite_layers = FullScreenPass(context, "dual_composite.frag")
        self._remaining_layers = FullScreenPass(context, "remaining_layers.frag")
        self._copy = FullScreenPass(context, "copy.frag.js")
        self._over_background = OverBackground(context)
        self._counter = SampleCounter()

    def draw(self, request: RenderRequest, target: moderngl.Framebuffer, is_picture: bool = True) -> None:
        """See :meth:`Compositor.draw`."""
        targets = self._targets
        targets.resize((request.camera.width, request.camera.height))
        targets.clear("bounds 1", 0.0, NONE)
        targets.clear("front 1")
        targets.clear("back 1")
        pair_count = request.settings.layers // 2
        for index in range(pair_count):
            self._peel(index)
            self._composite(index)
        last = self._peel_front(pair_count, request.settings.layers - pair_count)
        targets.framebuffer([f"front {last % 2}"]).use()
        blend_under(self._context)
        self._copy.run({"image": targets.texture(f"back {last % 2}")})
        self._over_background.run(targets.texture(f"front {last % 2}"), request, target, is_picture, self.discs.region)

    def _peel(self, index: int, front_only: bool = False) -> None:
        """Run geometry pass ``index``, counted from 0.

        A rank is the position of a disc in depth order, counted from 1 at the nearest disc. In each pixel, let a be the
        smallest rank and b the largest rank that the previous pass found. This pass finds the smallest and the largest
        of the ranks r with a < r < b. If ``front_only`` is True, the condition is only a < r.
        """
        targets = self._targets
        bounds, previous_bounds = f"bounds {index % 2}", f"bounds {1 - index % 2}"
        targets.clear(bounds, -NONE, -NONE)
        targets.texture(previous_bounds).use(0)
        blend_max(self._context)
        self.discs.draw("peel", targets.framebuffer([bounds]), bounds=0, front_only=front_only)

    def _composite(self, index: int, front_only: bool = False) -> None:
        """Composite the layers that geometry pass ``index`` has found."""
        targets = self._targets
        current, previous = index % 2, 1 - index % 2
        targets.framebuffer([f"front {current}", f"back {current}"]).use()
        disable_blending(self._context)
        sources = {"bounds": f"bounds {current}", "front": f"front {previous}", "back": f"back {previous}"}
        textures = {name: targets.texture(source) for name, source in sources.items()}
        self._composite_layers.run({**textures, "discs": self.discs.texture}, front_only=front_only)

    def _peel_front(self, first: int, max_layers: int) -> int:
        """Peel up to ``max_layers`` layers from the front, starting at pass ``first``.

        Returns the index of the last pass whose layers were composited.
        """
        self._peel(first)
        if not self._has_remaining_layers(first, clear_back=True):
            return first - 1
        for index in range(first, first + max_layers):
            if index > first:
                self._peel(index, front_only=True)
            if not self._has_remaining_layers(index, clear_back=False):
                return index - 1
            self._composite(index, front_only=True)
        return first + max_layers - 1

    def _has_remaining_layers(self, index: int, clear_back: bool) -> bool:
        """Return True if geometry pass ``index`` has found layers that are visible through the layers in front.

        If ``clear_back`` is True, hidden layers count too, and the layers composited from the back are cleared in each
        pixel in which the pass has found a layer.
        """
        targets = self._targets
        previous = 1 - index % 2
        # The occlusion query needs a framebuffer to draw into. If nothing needs clearing, it draws over the bounds of
        # the previous pass, which no later pass reads.
        targets.framebuffer([f"back {previous}" if clear_back else f"bounds {previous}"]).use()
        disable_blending(self._context)
        with self._counter:
            self._remaining_layers.run(
                {"bounds": targets.texture(f"bounds {index % 2}"), "front": targets.texture(f"front {previous}")},
                visible_only=not clear_back,
            )
        return self._counter.samples > 0

    def release(self) -> None:
        """Free all GL objects."""
        passes = (self._composite_layers, self._remaining_layers, self._copy, self._over_background)
        for item in (*passes, self._counter, self._targets, self.discs):
            item.release()


@contextmanager
def _upright_viewport(target: moderngl.Framebuffer, region: ImageRegion) -> Iterator[None]:
    """Bind ``target``, and restrict drawing to ``region`` until the block ends. Rows of ``region`` are counted from the
    top of the image, but OpenGL counts rows from the bottom."""
    target.use()
    width, height = target.size
    target.viewport = (region.left, height - region.bottom, region.right - region.left, region.bottom - region.top)
    yield
    target.viewport = (0, 0, width, height)


def _short_dtype(precision: Precision) -> str:
    return "f2" if precision == "float16" else "f4"
