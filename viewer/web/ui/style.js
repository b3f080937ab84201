/**
 * The style sheet of the player. Pages can set --fourd-accent. The buttons are large for fingers: on touch screens, and in
 * players as narrow as a phone. The bar has one row; a player that is too narrow for all controls has the button `more`.
 */
export const STYLE = `
:host { display: block; position: relative; overflow: hidden; background: #17181a; color: #fff;
  font: 14px/1.4 system-ui, sans-serif; outline: none; container-type: inline-size; --control: 32px; }
:host([hidden]) { display: none; }
canvas { position: absolute; inset: 0; width: 100%; height: 100%; touch-action: none; cursor: grab; }
:host([embedded]) canvas { touch-action: pan-y; }
:host([embedded]:not([links])) .link { display: none; }
canvas:active { cursor: grabbing; }
.poster { position: absolute; inset: 0; width: 100%; height: 100%; object-fit: contain; pointer-events: none; }
.bar { position: absolute; left: 0; right: 0; bottom: 0; display: flex; align-items: center; gap: 6px 8px;
  padding: 24px 12px 10px; background: linear-gradient(transparent, rgb(0 0 0 / 75%)); transition: opacity 0.2s; }
:host(.quiet) .bar { opacity: 0; }
:host(.quiet) .bar:focus-within { opacity: 1; }
.bar input[type="range"] { flex: 1 1 60px; min-width: 60px; height: var(--control); margin: 0; accent-color: var(--fourd-accent, #4da3ff); }
button, select { background: rgb(40 40 40 / 80%); color: inherit; border: 1px solid rgb(255 255 255 / 20%);
  border-radius: 6px; font: inherit; height: var(--control); max-width: 11em; padding: 0 8px; cursor: pointer; }
button { min-width: var(--control); padding: 0; }
svg { width: 20px; height: 20px; fill: currentColor; vertical-align: middle; }
button:hover, select:hover { background: rgb(80 80 80 / 90%); }
button[aria-pressed="true"] { border-color: var(--fourd-accent, #4da3ff); }
button:focus-visible, select:focus-visible, input:focus-visible { outline: 2px solid var(--fourd-accent, #4da3ff); }
.time { min-width: 84px; white-space: nowrap; text-align: right; font-variant-numeric: tabular-nums; }
.message { position: absolute; bottom: 96px; left: 12px; width: fit-content; max-width: calc(100% - 48px); padding: 8px 12px; border-radius: 6px;
  background: rgb(150 30 30 / 92%); overflow-wrap: anywhere; }
.extra { display: contents; }
.more { display: none; }
@container (max-width: 900px) {
  .more { display: block; }
  .extra { display: none; }
  .bar.open { flex-wrap: wrap; }
  .bar.open .extra { display: flex; flex-wrap: wrap; justify-content: end; gap: 6px 8px; flex-basis: 100%; }
  .bar.open ~ .message { bottom: 150px; }
}
@container (max-width: 480px) { .bar { --control: 44px; gap: 6px; } }
@container (max-width: 374px) { .with-sound .time { display: none; } }
@container (max-width: 320px) { .time { display: none; } }
@container (max-width: 240px) {
  .bar { --control: 32px; padding-inline: 4px; }
  .bar input[type="range"] { display: none; }
}
@media (pointer: coarse) { :host { --control: 44px; } }
.message.note { background: rgb(40 40 40 / 92%); }
.help { position: absolute; top: 12px; left: 12px; padding: 10px 14px; border-radius: 6px; background: rgb(20 20 20 / 88%);
  max-height: calc(100% - 90px); overflow: auto; }
.help table { border-spacing: 10px 1px; }
.with-fingers { display: none; }
@media (hover: none) and (pointer: coarse) {
  .with-keys { display: none; }
  .with-fingers { display: table; }
}
.spinner { position: absolute; left: 50%; top: 50%; width: 40px; height: 40px; margin: -20px; border-radius: 50%;
  border: 4px solid rgb(255 255 255 / 25%); border-top-color: #fff; animation: turn 1s linear infinite; pointer-events: none; }
[hidden] { display: none !important; }
@keyframes turn { to { transform: rotate(360deg); } }
@media (prefers-reduced-motion: reduce) { .spinner { animation-duration: 4s; } }
`;
