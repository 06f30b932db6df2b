// What the browser remembers. Storage can be forbidden, as in a frame of another site: then nothing outlasts the page.

/** @param {"localStorage"|"sessionStorage"} where For ever, or for this tab. @returns {string|null} */
export function recall(key, where = "localStorage") {
  try {
    return window[where].getItem(key);
  } catch {
    return null;
  }
}

/** @param {"localStorage"|"sessionStorage"} where @returns {boolean} Whether it is kept. */
export function remember(key, value, where = "localStorage") {
  try {
    window[where].setItem(key, value);
    return true;
  } catch {
    return false;
  }
}
