/** The largest possible compression ratio of a deflate stream (zlib, technical details). */
const LARGEST_RATIO = 1032;
const SLACK_BYTES = 64;

/**
 * Returns the maximum size in bytes of a member after decompression.
 * @param {number} size Compressed size in bytes.
 */
export function largestContent(size) {
  return LARGEST_RATIO * size + SLACK_BYTES;
}
