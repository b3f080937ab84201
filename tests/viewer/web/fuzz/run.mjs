/**
 * Reads damaged scenes with the web player's modules.
 *
 *   node run.mjs SEED COUNT SCENE...    reads COUNT damaged scenes
 *   node run.mjs SEED =CASE SCENE...    reads one of them again, and prints the error
 *
 * Prints a JSON object for each case that ends with neither a scene nor a SceneError. At the end, it prints the number
 * of scenes that were read, the number that were rejected, the number of different messages, and the largest resident
 * set size in bytes. The resident set size is read after each case, because the maximum that the system reports
 * includes the parent process.
 */

import { readFileSync } from "node:fs";
import { SceneError } from "../../../../viewer/web/scene/errors.js";
import { Random, mutate, splitScene } from "./mutate.mjs";
import { readScene } from "./read.mjs";

const SLOW_MS = 20000;
const LONGEST_MESSAGE = 400;

const [seed, count, ...paths] = process.argv.slice(2);
const scenes = paths.map((path) => splitScene(new Uint8Array(readFileSync(path))));
const first = count.startsWith("=") ? Number(count.slice(1)) : 0;
const end = count.startsWith("=") ? first + 1 : Number(count);
const result = { read: 0, refused: 0, peakMemory: 0 };
/** The number of rejected scenes for each message. The keys are the first words of the messages. */
const messages = {};
for (let index = first; index < end; index++) {
  const random = new Random(Math.imul(Number(seed), 0x9e3779b1) + index);
  const bytes = mutate(random.pick(scenes), random);
  const watchdog = setTimeout(() => stop(index, "the reader does not return"), SLOW_MS);
  try {
    await readScene(bytes);
    result.read++;
  } catch (error) {
    if (end === first + 1) console.error(error);
    if (!(error instanceof SceneError)) report(index, error.stack ?? String(error));
    else if (!isClear(error.message)) report(index, `unclear message: ${JSON.stringify(error.message)}`);
    result.refused++;
    const words = error.message.replace(/[0-9]+/g, "0").slice(0, 60);
    messages[words] = (messages[words] ?? 0) + 1;
  }
  clearTimeout(watchdog);
  result.peakMemory = Math.max(result.peakMemory, process.memoryUsage.rss());
  // Without a garbage collection here, garbage of earlier cases would count as memory of later cases.
  globalThis.gc?.();
}
result.messages = Object.keys(messages).length;
console.log(JSON.stringify(result));

function isClear(message) {
  return message.length > 10 && message.length <= LONGEST_MESSAGE && !/[\x00-\x1f]/.test(message);
}

function report(index, problem) {
  console.log(JSON.stringify({ seed: Number(seed), case: index, problem }));
}

function stop(index, problem) {
  report(index, problem);
  process.exit(1);
}
