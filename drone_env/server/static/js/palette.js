// The colours of canvases: the custom properties of the style sheet, each read once per theme.

const read = new Map();

/** The value of a custom property, such as `--ink`, or the colour of a pilot: `--pilot-3`. */
export function colourOf(name) {
  if (!read.has(name)) read.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return read.get(name);
}

/** Another theme is shown: the colours are read again. */
export const forgetColours = () => read.clear();

/** The page's font for a canvas, so many device pixels high. */
export const font = (size, weight = 500) => `${weight} ${size}px ${colourOf("--font")}`;

const LABELS = { best: "--good", inaccuracy: "--warn", mistake: "--accent", blunder: "--bad" };

/** The colour of a move's label, such as "blunder". */
export const labelColour = (label) => colourOf(LABELS[label] ?? "--ink-3");
