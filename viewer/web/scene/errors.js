/** An error with a message for the user: one line with what was expected, what was found, and the fix. */
export class SceneError extends Error {}

/** The content of the scene has changed since the scene was opened. */
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
