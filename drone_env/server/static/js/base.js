// What all parts of the page build on: events, animation frames, storage, colours, and canvases that fill their element.

/** Calls listeners: the parts of the page communicate by events alone. */
export class Emitter {
  constructor() {
    this.listeners = new Map();
  }

  /** Calls f at every event. */
  on(type, f) {
    this.listeners.set(type, [...(this.listeners.get(type) ?? []), f]);
  }

  emit(type, ...args) {
    for (const f of this.listeners.get(type) ?? []) f(...args);
  }
}

const due = new Set();
let asked = false;

/** Calls `draw(now)` in the next animation frame, once, however often it is requested. */
export function nextFrame(draw) {
  due.add(draw);
  if (asked) return;
  asked = true;
  requestAnimationFrame((now) => {
    asked = false;
    const drawers = [...due];
    due.clear();
    for (const draw of drawers) draw(now);
  });
}

const still = matchMedia("(prefers-reduced-motion: reduce)");

/** Whether the visitor asked for less motion. */
export const lessMotion = () => still.matches;

/** @param {"localStorage"|"sessionStorage"} where @returns {string|null} Null also if storage is forbidden, as in a frame of another site. */
export function recall(key, where = "localStorage") {
  try {
    return window[where].getItem(key);
  } catch {
    return null;
  }
}

/** Stores a value if storage is allowed. @param {"localStorage"|"sessionStorage"} where For ever, or for this tab. */
export function remember(key, value, where = "localStorage") {
  try {
    window[where].setItem(key, value);
  } catch {
    // Then nothing outlasts the page.
  }
}

const colours = new Map();

/** The value of a custom property of the style sheet, such as `--ink`; each is read once per theme. */
export function colourOf(name) {
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return colours.get(name);
}

/** Another theme is shown: the colours are read again. */
export const forgetColours = () => colours.clear();

/** The page's font for a canvas, so many device pixels high. */
export const font = (size, weight = 500) => `${weight} ${size}px ${colourOf("--font")}`;

const LABELS = { best: "--good", inaccuracy: "--warn", mistake: "--accent", blunder: "--bad" };

/** The colour of a move's label, such as "blunder". */
export const labelColour = (label) => colourOf(LABELS[label] ?? "--ink-3");

/**
 * Keeps a canvas as large as an element, sharp at any pixel density. The size comes from an observer: drawing forces no layout.
 *
 * @param {() => void} resized Called when the size or the density has changed.
 * @returns {{width: number, height: number, scale: number}} Size in CSS pixels, device pixels per one.
 */
export function fit(root, canvas, resized) {
  const size = { width: 0, height: 0, scale: 1 };
  const observer = new ResizeObserver(([entry]) => {
    // Whole pixels: a canvas stretched by a fraction would be blurred.
    const width = Math.floor(entry.contentRect.width);
    const height = Math.floor(entry.contentRect.height);
    Object.assign(size, { width, height, scale: window.devicePixelRatio || 1 });
    canvas.width = Math.round(width * size.scale);
    canvas.height = Math.round(height * size.scale);
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
    resized();
  });
  observer.observe(root);
  return size;
}
