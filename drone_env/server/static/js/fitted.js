// Canvases that fill their element, sharp at any pixel density. Sizes come from an observer, never from a layout that is
// forced while drawing.

/**
 * @param {HTMLElement} root Whose size the canvases take. @param {HTMLCanvasElement[]} canvases
 * @param {() => void} resized Called when the size or the density has changed.
 * @returns {{width: number, height: number, scale: number, stop: () => void}} Size in CSS pixels, device pixels per one.
 */
export function fit(root, canvases, resized) {
  const size = { width: 0, height: 0, scale: 1, stop: () => observer.disconnect() };
  const observer = new ResizeObserver(([entry]) => {
    // Whole pixels: a canvas that were stretched by a fraction would be blurred.
    const width = Math.floor(entry.contentRect.width);
    const height = Math.floor(entry.contentRect.height);
    Object.assign(size, { width, height, scale: window.devicePixelRatio || 1 });
    for (const canvas of canvases) {
      canvas.width = Math.round(width * size.scale);
      canvas.height = Math.round(height * size.scale);
      canvas.style.width = `${width}px`;
      canvas.style.height = `${height}px`;
    }
    resized();
  });
  observer.observe(root);
  return size;
}

/** A cleared canvas whose unit is the CSS pixel; null where there is nothing to draw on. */
export function cleared(canvas, { width, height, scale }) {
  if (!width || !height) return null;
  const ctx = canvas.getContext("2d");
  ctx.setTransform(scale, 0, 0, scale, 0, 0);
  ctx.clearRect(0, 0, width, height);
  return ctx;
}
