/**
 * Functions that compare_viewers.py adds to each page. A page has `window.viewer`, a promise of {draw, canvas}. The
 * function `draw` draws an image from a camera that is passed as {camera, view, projection}.
 */

const nextImage = () => new Promise((resolve) => requestAnimationFrame(resolve));

/** Draws from one camera for three seconds, to give the viewer time to sort the splats by depth. Returns the canvas as
 * a PNG file in base64. */
window.picture = async (camera) => {
  const { draw, canvas } = await window.viewer;
  const end = performance.now() + 3000;
  while (performance.now() < end) {
    draw(camera);
    await nextImage();
  }
  draw(camera);
  return canvas.toDataURL("image/png").split(",")[1];
};

/** Returns the number of images per second while the camera moves along a path. Each image is finished before the next
 * one starts. */
window.imagesPerSecond = async (cameras, seconds) => {
  const { draw, canvas } = await window.viewer;
  const gl = canvas.getContext("webgl2");
  const pixel = new Uint8Array(4);
  const started = performance.now();
  let images = 0;
  while (performance.now() - started < 1000 * seconds) {
    draw(cameras[images++ % cameras.length]);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    await nextImage();
  }
  return (1000 * images) / (performance.now() - started);
};
