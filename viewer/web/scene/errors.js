/** An error with a one-line message for the user, which says what was expected, what was found, and how to fix it. */
export class SceneError extends Error {}

/** Thrown if the scene has changed on the server since it was opened. */
export class ChangedError extends SceneError {
  constructor() {
    super("The scene has changed on the server. Reload the page.");
  }
}

/**
 * Returns the text that the page shows for an error.
 * @param {unknown} error
 * @returns {string}
 */
export function describeError(error) {
  if (error instanceof SceneError) return error.message;
  return `The player failed: ${error instanceof Error ? error.message : String(error)}`;
}
