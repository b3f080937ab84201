/**
 * The state of a run, as the server sends it.
 * @typedef {object} Status
 * @property {string} title
 * @property {number | null} segment Number of the segment, counted from 1. Null for a run without segments.
 * @property {string} session Identifies the training process to which requests are sent.
 * @property {"training" | "paused" | "finished" | "stopped" | "failed" | "ended" | "idle"} phase
 * @property {string} reason
 * @property {number} step
 * @property {number | null} max_steps
 * @property {number | null} spent Fraction of the budget that has been spent.
 * @property {number} seconds Training time.
 * @property {number | null} remaining_seconds
 * @property {boolean} is_held_out
 * @property {string} held_out The held-out score in words, or an empty text if it was not measured yet.
 * @property {number | null} psnr In dB, of the training views, smoothed.
 * @property {number | null} validation_psnr In dB.
 * @property {number[]} pictures Training steps of the validation images.
 * @property {number} broken_lines Number of lines in the log that are not valid records.
 */
/** The values of a measurement. @typedef {{step: number[], value: number[]}} Series */
/**
 * State of the scene. `progress` is null while no scene is being baked.
 * @typedef {object} SceneState
 * @property {"none" | "baking" | "ready" | "failed"} state
 * @property {number} step
 * @property {string} message
 * @property {{work: string, done: number, count: number} | null} progress
 */

/** Thrown if the server refuses a request or does not answer. The page shows the message to the user. */
export class Refusal extends Error {}

/** @returns {Promise<Status>} */
export async function fetchStatus() {
  return fetchJson("run/status.json");
}

/** @returns {Promise<Record<string, Series>>} */
export async function fetchCurves() {
  return fetchJson("run/curves.json");
}

/**
 * Requests the scene of the newest checkpoint. The server bakes new checkpoints only while a page requests the scene.
 * @returns {Promise<SceneState>}
 */
export async function fetchScene() {
  return fetchJson("run/scene.json");
}

/**
 * @param {string} session
 * @param {"pause" | "resume" | "save" | "stop"} action
 */
export async function sendRequest(session, action) {
  // The server requires this header, which pages of other sites cannot send.
  const headers = { "Content-Type": "application/json", "X-Fourd-Request": "control" };
  await fetchText("run/control", { method: "POST", headers, body: JSON.stringify({ session, action }) });
}

/** @param {string} path */
async function fetchJson(path) {
  const text = await fetchText(path, { cache: "no-cache" });
  try {
    return JSON.parse(text);
  } catch {
    throw new Refusal("The server sent an incomplete answer. This page asks again.");
  }
}

/**
 * @param {string} path
 * @param {RequestInit} options
 */
async function fetchText(path, options) {
  let response, text;
  try {
    response = await fetch(path, { ...options, signal: AbortSignal.timeout(15000) });
    text = await response.text();
  } catch {
    throw new Refusal("The server does not answer. This page asks again until fourd serve runs.");
  }
  if (!response.ok) throw new Refusal(text.trim().slice(0, 500) || `The server answered with HTTP status ${response.status}.`);
  return text;
}
