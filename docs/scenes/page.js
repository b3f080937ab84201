// Scenes in the pages of this site. A `div` of the class "scene" has either a player, or a button with a picture that
// starts one. The player is loaded after everything that the page shows first.

/** Duration of a turn around the scene in seconds. */
const TURN_S = 24;
/** Attributes of the players that buttons start, without those of the single scene. */
const ATTRIBUTES = { autoplay: "", embedded: "" };

/** The scene of a button that plays. Only one plays at a time, because each takes memory and the graphics processor. */
let playing = null;

for (const button of document.querySelectorAll(".scene > button")) {
  button.addEventListener("click", () => start(button));
}
if (document.readyState === "complete") loadAfterPaint();
else window.addEventListener("load", loadAfterPaint, { once: true });

new MutationObserver(nameCodeBars).observe(document.body, { childList: true, subtree: true });
nameCodeBars();

/** Loads the player when the browser has drawn the page. */
function loadAfterPaint() {
  requestAnimationFrame(() => requestAnimationFrame(load));
}

/** Loads the player. The template has preload links for all modules, which would otherwise arrive one after the other. */
async function load() {
  document.head.append(document.querySelector("#player-modules").content);
  const [{ orbit }] = await Promise.all([import("../player/navigate/pose.js"), import("../player/fourd-player.js")]);
  for (const player of document.querySelectorAll(".scene > fourd-player")) turn(player, orbit);
}

/** Gives a name to the theme's bar of buttons of each code block, because several landmarks without names are a maze. */
function nameCodeBars() {
  document.querySelectorAll(".md-code__nav:not([aria-label])").forEach((bar) => {
    bar.setAttribute("aria-label", `Buttons of code block ${[...document.querySelectorAll(".md-code__nav")].indexOf(bar) + 1}`);
  });
}

/** Turns the view around the scene while it plays, until the visitor moves the view. */
function turn(player, orbit) {
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  let isTurning = true;
  for (const input of ["pointerdown", "keydown", "change"]) {
    player.addEventListener(input, () => (isTurning = false), { once: true });
  }
  let last = performance.now();
  const step = (now) => {
    const { stage } = player;
    if (!isTurning) return;
    if (player.isInView && stage?.clock.isPlaying) {
      stage.setPose(orbit(stage.pose, (2 * Math.PI * (now - last)) / 1000 / TURN_S, 0));
    }
    last = now;
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
}

/** Plays the scene of a button in its place, and shows the button of the scene that played before. */
function start(button) {
  if (playing) {
    playing.player.remove();
    playing.button.hidden = false;
  }
  const player = document.createElement("fourd-player");
  const { src, stylize } = button.dataset;
  for (const [name, value] of Object.entries({ ...ATTRIBUTES, src, stylize })) {
    if (value !== undefined) player.setAttribute(name, value);
  }
  player.setAttribute("aria-label", button.querySelector("span").innerText);
  player.setAttribute("poster", button.querySelector("img").src);
  button.hidden = true;
  button.after(player);
  player.focus();
  playing = { button, player };
}
