/** The largest possible ratio of decompressed size to compressed size of a deflate stream (zlib, technical details). */
const LARGEST_RATIO = 1032;
const SLACK_BYTES = 64;

/**
 * The largest content in bytes that a compressed member can have.
 * @param {number} size Compressed size in bytes.
 */
export function largestContent(size) {
  return LARGEST_RATIO * size + SLACK_BYTES;
}
