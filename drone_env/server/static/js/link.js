// A link within the page: a click goes there, and the browser can open it in a tab of its own.
import { el } from "./dom.js";
import { linkOf } from "./router.js";

/** @param {import("./router.js").Router} router @param {string} tag As of `el`. @param {Object} address Where to. */
export function linkTo(router, tag, address, text, more = {}) {
  const press = (event) => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    router.go(address);
  };
  return el(tag, { href: linkOf({ pilots: [], ...address }), text, press, ...more });
}
