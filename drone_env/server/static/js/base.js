// Shared helpers: events, animation frames, storage, colours and canvases.

/** An event emitter: the parts of the page communicate by events. */
export class Emitter {
  constructor() {
    this.listeners = new Map();
  }

  on(type, f) {
    this.listeners.set(type, [...(this.listeners.get(type) ?? []), f]);
  }

  emit(type, ...args) {
    for (const f of this.listeners.get(type) ?? []) f(...args);
  }
}

const due = new Set();
let scheduled = false;

/** Calls `draw(now)` once in the next animation frame, however often it is asked to. */
export function nextFrame(draw) {
  due.add(draw);
  if (scheduled) return;
  scheduled = true;
  requestAnimationFrame((now) => {
    scheduled = false;
    const drawers = [...due];
    due.clear();
    for (const draw of drawers) draw(now);
  });
}

/** Whether fingers are the main way to point. */
export const TOUCH = matchMedia("(pointer: coarse)").matches;

export const lessMotion = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

/** Values that last as long as the page: storage is full, or blocked as in a cross-site frame. */
const unstored = new Map();

/** @param {"localStorage"|"sessionStorage"} where @returns {string|null} */
export function recall(key, where = "localStorage") {
  try {
    return unstored.get(key) ?? window[where].getItem(key);
  } catch {
    return null;
  }
}

/** @param {"localStorage"|"sessionStorage"} where */
export function remember(key, value, where = "localStorage") {
  try {
    unstored.delete(key);
    window[where].setItem(key, value);
  } catch {
    unstored.set(key, value);
  }
}

const colours = new Map();

/** A custom property of the style sheet, such as `--ink`, cached per theme. */
export function colourOf(name) {
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return colours.get(name);
}

export const forgetColours = () => colours.clear();

/** The page's font for a canvas, in device pixels. */
export const font = (size, weight = 500) => `${weight} ${size}px ${colourOf("--font")}`;

const LABELS = { best: "--good", inaccuracy: "--warn", mistake: "--accent", blunder: "--bad" };

/** The colour of a move's label, such as "blunder". */
export const labelColour = (label) => colourOf(LABELS[label] ?? "--ink-3");

/**
 * Keeps a canvas as large as an element, at any pixel density. A ResizeObserver reads the size without a forced layout.
 * @param {() => void} resized Called after a change.
 * @returns {{width: number, height: number, scale: number}} Size in CSS pixels, device pixels per one.
 */
export function fit(root, canvas, resized) {
  const size = { width: 0, height: 0, scale: 1 };
  const observer = new ResizeObserver(([entry]) => {
    // Whole pixels keep the canvas sharp.
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
