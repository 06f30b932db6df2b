// The colours of canvases: the custom properties of the style sheet, read once per theme.

const NAMES = [
  "ground",
  "panel",
  "line",
  "line-strong",
  "ink",
  "ink-2",
  "ink-3",
  "accent",
  "good",
  "warn",
  "bad",
  "font",
  "map-ground",
  "map-grid",
  "map-edge",
  "map-night",
  "map-shade",
  "map-box",
  "map-ghost",
  "map-label",
];
const camel = (name) => name.replace(/^map-/, "").replace(/-(\w)/g, (_, letter) => letter.toUpperCase());

let read = null;

/** `{ink, accent, ..., map: {ground, roof, ...}}` of the theme that is shown. */
export function palette() {
  if (read) return read;
  const style = getComputedStyle(document.documentElement);
  read = { map: {} };
  for (const name of NAMES) {
    const value = style.getPropertyValue(`--${name}`).trim();
    if (name.startsWith("map-")) read.map[camel(name)] = value;
    else read[camel(name)] = value;
  }
  read.named = new Map();
  return read;
}

/** The colour behind a custom property, such as that of a pilot: `--pilot-3`. */
export function colourOf(name) {
  const { named } = palette();
  if (!named.has(name)) named.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return named.get(name);
}

/** Another theme is shown: the colours are read again. */
export function forgetPalette() {
  read = null;
}

/** The colour of a move's label, such as "blunder". */
export function labelColour(label) {
  const p = palette();
  return { best: p.good, good: p.ink3, inaccuracy: p.warn, mistake: p.accent, blunder: p.bad }[label] ?? p.ink3;
}
