import { SceneError } from "./errors.js";

/** Reads and checks the values of a JSON object in a manifest, which is untrusted input. */
export class JsonNode {
  /**
   * @param {unknown} content
   * @param {string} where Path of the object inside the manifest, for error messages.
   */
  constructor(content, where) {
    if (typeof content !== "object" || content === null || Array.isArray(content)) {
      throw new SceneError(`${where}: expected a JSON object, got ${format(content)}; export the scene again`);
    }
    /** @type {Record<string, unknown>} */
    this.content = /** @type {Record<string, unknown>} */ (content);
    this.where = where;
  }

  /** @param {string} key */
  has(key) {
    return Object.hasOwn(this.content, key);
  }

  /**
   * @param {string} key
   * @param {string} expected
   * @returns {SceneError}
   */
  failure(key, expected) {
    const got = this.has(key) ? format(this.content[key]) : "nothing";
    return new SceneError(`${this.where}, ${printable(key)}: expected ${expected}, got ${got}; export the scene again`);
  }

  /** @param {string} key */
  node(key) {
    if (!this.has(key)) throw this.failure(key, "a JSON object");
    return new JsonNode(this.content[key], `${this.where}, ${printable(key)}`);
  }

  /**
   * @param {string} key
   * @param {number} most
   * @returns {JsonNode[]}
   */
  nodes(key, most) {
    const value = this.content[key];
    if (!Array.isArray(value) || value.length > most) throw this.failure(key, `a list of at most ${most} objects`);
    return value.map((item, index) => new JsonNode(item, `${this.where}, ${key}[${index}]`));
  }

  /**
   * @param {string} key
   * @returns {string}
   */
  text(key) {
    const value = this.content[key];
    if (typeof value !== "string" || value.length > 255) throw this.failure(key, "text of at most 255 characters");
    return value;
  }

  /**
   * @param {string} key
   * @param {boolean} [missing] Result if the key is missing. The key is required if this is not given.
   * @returns {boolean}
   */
  flag(key, missing) {
    if (missing !== undefined && !this.has(key)) return missing;
    const value = this.content[key];
    if (typeof value !== "boolean") throw this.failure(key, "true or false");
    return value;
  }

  /**
   * @param {string} key
   * @param {number} low
   * @param {number} high
   * @param {number} [missing] Result if the key is missing. The key is required if this is not given.
   * @returns {number}
   */
  number(key, low, high, missing) {
    if (missing !== undefined && !this.has(key)) return missing;
    const value = this.content[key];
    if (typeof value !== "number" || !(value >= low && value <= high)) {
      throw this.failure(key, `a number from ${low} to ${high}`);
    }
    return value;
  }

  /**
   * @param {string} key
   * @param {number} low
   * @param {number} high
   * @returns {number}
   */
  integer(key, low, high) {
    const value = this.number(key, low, high);
    if (!Number.isInteger(value)) throw this.failure(key, `a whole number from ${low} to ${high}`);
    return value;
  }

  /**
   * @param {string} key
   * @param {number} count
   * @returns {number[]}
   */
  numbers(key, count) {
    const value = this.content[key];
    if (!Array.isArray(value) || value.length !== count || !value.every(isUsable)) {
      throw this.failure(key, `${count} finite numbers`);
    }
    return value;
  }

  /**
   * Returns the rows of a 3 x 3 matrix, joined into one list.
   * @param {string} key
   * @returns {number[]}
   */
  matrix(key) {
    const rows = this.content[key];
    if (!Array.isArray(rows) || rows.length !== 3) throw this.failure(key, "3 rows of 3 finite numbers");
    return rows.flatMap((row) => new JsonNode({ row }, `${this.where}, ${key}`).numbers("row", 3));
  }
}

/**
 * @param {unknown} value
 * @returns {boolean}
 */
function isUsable(value) {
  return typeof value === "number" && Math.abs(value) < 1e30;
}

/**
 * Converts a key to one line of text for error messages.
 * @param {string} key
 */
function printable(key) {
  return /^[\w./]{1,60}$/.test(key) ? key : format(key);
}

/**
 * @param {unknown} value
 * @returns {string}
 */
function format(value) {
  const text = value === undefined ? "nothing" : JSON.stringify(value);
  return text.length <= 60 ? text : `${text.slice(0, 57)}...`;
}
