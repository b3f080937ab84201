/**
 * The element with an identifier, which the page must have.
 * @param {string} id
 * @returns {HTMLElement}
 */
export function byId(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`expected an element with the id '${id}'`);
  return found;
}

/**
 * The button with an identifier.
 * @param {string} id
 * @returns {HTMLButtonElement}
 */
export function buttonById(id) {
  return /** @type {HTMLButtonElement} */ (byId(id));
}

/**
 * The first descendant of an element with a tag name, which must exist.
 * @template {keyof HTMLElementTagNameMap} Name
 * @param {HTMLElement} parent
 * @param {Name} name
 * @returns {HTMLElementTagNameMap[Name]}
 */
export function within(parent, name) {
  const found = parent.querySelector(name);
  if (!found) throw new Error(`expected an element '${name}'`);
  return found;
}

/**
 * Changes a text only if it differs, so that selected text stays selected.
 * @param {Element} target
 * @param {string} text
 */
export function setText(target, text) {
  if (target.textContent !== text) target.textContent = text;
}
