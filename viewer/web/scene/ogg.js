import { SceneError } from "./errors.js";

const PAGE_HEADER = 27;
const LAST_PAGE = 4;
/** Samples of a frame for each of the 32 configurations of an Opus packet (RFC 6716, table 2). */
const FRAME_SAMPLES = [...repeat([480, 960, 1920, 2880], 3), ...repeat([480, 960], 2), ...repeat([120, 240, 480, 960], 4)];
const MAX_PACKET = 5760;
const HEADERS = 2;

/**
 * Returns the duration of Opus in an Ogg file, in seconds, summed from the headers of the packets. The file is untrusted:
 * a few bytes of Opus can decode to minutes of sound, so the duration is checked before the browser decodes the file.
 * @param {Uint8Array} bytes
 */
export function opusSeconds(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let position = 0;
  let packets = 0;
  let samples = 0;
  let isStart = true;
  let isComplete = false;
  while (position < bytes.length) {
    if (position + PAGE_HEADER > bytes.length || view.getUint32(position) !== 0x4f676753 || isComplete) throw damaged();
    isComplete = (bytes[position + 5] & LAST_PAGE) !== 0;
    const count = bytes[position + 26];
    let data = position + PAGE_HEADER + count;
    for (let index = 0; index < count; index++) {
      const size = bytes[position + PAGE_HEADER + index];
      if (data + size > bytes.length) throw damaged();
      if (isStart && packets++ >= HEADERS) samples += packetSamples(bytes, data, size);
      isStart = size < 255;
      data += size;
    }
    position = data;
  }
  if (!isComplete || packets <= HEADERS) throw damaged();
  return samples / 48000;
}

/**
 * @param {Uint8Array} bytes
 * @param {number} start
 * @param {number} size
 */
function packetSamples(bytes, start, size) {
  const code = bytes[start] & 3;
  if (size < 1 || (code === 3 && size < 2)) throw damaged();
  const frames = [1, 2, 2, bytes[start + 1] & 63][code];
  const samples = frames * FRAME_SAMPLES[bytes[start] >> 3];
  if (samples < 1 || samples > MAX_PACKET) throw damaged();
  return samples;
}

/**
 * @param {number[]} values
 * @param {number} times
 */
function repeat(values, times) {
  return Array.from({ length: times }, () => values).flat();
}

function damaged() {
  return new SceneError("sound.ogg: expected Opus in a complete Ogg file, got another file; export the scene again");
}
