/** Returns an error message if the browser cannot decode the images of scenes, and null otherwise. */
export function missingDecoder() {
  if (typeof VideoDecoder !== "undefined") return null;
  const secure = globalThis.isSecureContext ? "" : " over an address without https";
  return (
    `The scene has the tier video, which needs WebCodecs, and this browser does not offer it${secure}; ` +
    "use https and a current browser, or write the page with fourd web --tier stream"
  );
}
