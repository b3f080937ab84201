/**
 * Returns the element with this identifier, which must exist in the page.
 * @param {string} id
 * @returns {HTMLElement}
 */
export function byId(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`expected an element with the id '${id}'`);
  return found;
}

/**
 * Returns the button with this identifier.
 * @param {string} id
 * @returns {HTMLButtonElement}
 */
export function buttonById(id) {
  return /** @type {HTMLButtonElement} */ (byId(id));
}

/**
 * Returns an element's first descendant with this tag name, which must exist.
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
 * Sets the text of an element only if the text differs, so that selected text stays selected.
 * @param {Element} target
 * @param {string} text
 */
export function setText(target, text) {
  if (target.textContent !== text) target.textContent = text;
}
