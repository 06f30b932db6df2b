// The logs view.

/** @param {HTMLElement} root An empty section. @param {import("./context.js").Context} context */
export function mount(root, context) {}
