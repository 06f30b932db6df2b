// DOM helpers. Text is always set as text, never as HTML.
import { thousands } from "./format.js";

/**
 * @template {string} Tag
 * @param {Tag} tag Element name, with optional classes: `div.gauge.wide`; `svg:path` for an SVG element.
 * @param {...any} contents Properties, then children. `text` sets textContent, `press` adds a click
 *   listener, `on` adds listeners, `style` sets styles and custom properties, `data` sets data attributes; null and
 *   undefined are skipped; all other properties are attributes.
 * @returns {Made<Tag>} A button has the type "button" by default.
 */
export function el(tag, ...contents) {
  const given = contents[0]?.constructor === Object ? contents.shift() : {};
  const [name, ...classes] = tag.split(".");
  const props = name === "button" ? { type: "button", ...given } : given;
  /** @type {any} */
  const node = name.startsWith("svg:")
    ? document.createElementNS("http://www.w3.org/2000/svg", name.slice(4))
    : document.createElement(name);
  if (classes.length) node.setAttribute("class", classes.join(" "));
  for (const [key, value] of Object.entries(props)) {
    if (value === null || value === undefined) continue;
    if (key === "text") node.textContent = value;
    else if (key === "press") node.addEventListener("click", value);
    else if (key === "on") for (const [type, f] of Object.entries(value)) node.addEventListener(type, f);
    else if (key === "data") Object.assign(node.dataset, value);
    else if (key === "style") for (const [k, v] of Object.entries(value)) node.style.setProperty(k, v);
    else if (typeof value === "boolean" || key === "value") node[key] = value;
    else node.setAttribute(key, value);
  }
  node.append(...contents.filter((child) => child !== null && child !== undefined));
  return node;
}

/** Adds the actions of buttons by their ids. @param {Element} root @param {Object<string, () => any>} acts */
export function onPress(root, acts) {
  for (const [id, act] of Object.entries(acts)) root.querySelector(`#${id}`).addEventListener("click", () => act());
}

export const fact = (name, text) => el("div", el("dt", { text: name }), el("dd", { text }));

/** A table with a caption for screen readers. @param {any[][]} columns Names, and whether a column contains numbers. */
export function table(tag, props, caption, columns, ...bodies) {
  return el(
    tag,
    props,
    el("caption.visually-hidden", { text: caption }),
    el(
      "thead",
      el("tr", ...columns.map(([text, number]) => (text ? el(number ? "th.num" : "th", { scope: "col", text }) : el("td")))),
    ),
    ...bodies,
  );
}

/** A place that a wide or long table scrolls in. */
export const scroller = (name, table) => el("div.scroller", { tabindex: "0", role: "region", "aria-label": name }, table);

/** Number of rows that a long table shows at first: the layout of a thousand takes a moment. */
const SHOWN = 200;

/**
 * A table that scrolls if it is larger than its place. A press on the head of a column with values sorts by them.
 * @param {any[][]} columns Name, content, whether it is a number, value of a row.
 * @param {string} [by] The column that it is sorted by at first, the largest value first.
 */
export function grid(caption, columns, rows, by) {
  const cells = (row) => columns.map(([name, cell, number]) => el(number ? "td.num" : "td", { data: { name } }, cell(row)));
  const lines = rows.map((row) => ({ row, line: el("tr", ...cells(row)) }));
  const body = el("tbody");
  const names = columns.map(([name, , number]) => [name, number]);
  const shown = table("table.table", {}, caption, names, body);
  const heads = [...shown.querySelectorAll("thead tr > *")];
  const all = el("button.button.small", { text: `Show all ${thousands(rows.length)}`, press: () => fill(rows.length) });
  const fill = (most) => {
    body.replaceChildren(...lines.slice(0, most).map(({ line }) => line));
    all.hidden = body.childElementCount === rows.length;
  };
  function sort(head, value) {
    const down = head.ariaSort !== "descending";
    for (const one of heads) one.ariaSort = null;
    head.ariaSort = down ? "descending" : "ascending";
    lines.sort((x, y) => (down ? 1 : -1) * (value(y.row) - value(x.row)));
    fill(Math.max(body.childElementCount, SHOWN));
  }
  fill(SHOWN);
  columns.forEach(([text, , , value], i) => {
    if (value) heads[i].replaceChildren(el("button.sort", { text, press: () => sort(heads[i], value) }));
    if (text === by) sort(heads[i], value);
  });
  return el("div", scroller(caption, shown), all);
}

/** Sets the text of a node if it differs, to avoid a layout. */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** An icon of 24 by 24 units; a path that starts with `!` is filled. */
export function icon(...paths) {
  const drawn = paths.map((d) => {
    const solid = d.startsWith("!");
    return el(solid ? "svg:path.solid" : "svg:path", { d: solid ? d.slice(1) : d });
  });
  return el("svg:svg", { viewBox: "0 0 24 24", "aria-hidden": "true" }, ...drawn);
}

export function download(name, blob) {
  const url = URL.createObjectURL(blob);
  const link = el("a", { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** Asks a question with two answers. @returns {Promise<boolean>} Whether the visitor chose the first one. */
export function ask(question, yes, no) {
  const dialog = document.getElementById("ask");
  const texts = [question, yes, no];
  dialog.querySelectorAll("h2, button").forEach((node, i) => (node.textContent = texts[i]));
  dialog.returnValue = "no";
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"), { once: true });
  });
}

/** The next key is for the drone, not for the focused element. */
export const leaveFocus = () => document.activeElement instanceof HTMLElement && document.activeElement.blur();

/** Draws again; the focus stays on the element with the same `data-key`. */
export function keepFocus(root, draw) {
  const key = document.activeElement instanceof HTMLElement && document.activeElement.dataset.key;
  draw();
  if (key) root.querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus();
}

/** A short message, also for screen readers: over the map, where it covers no button, or else above the view. */
export function toast(text) {
  const node = el("div.toast", { text });
  const toasts = document.getElementById("toasts");
  const map = document.querySelector(".view:not([hidden], :has(.plan-details[open])) .boards-field");
  const top = map ? map.getBoundingClientRect().top : -1;
  const place = top >= 0 && top < window.innerHeight / 2 ? map : document.getElementById("main");
  if (toasts.parentElement !== place) place.prepend(toasts);
  [...toasts.children].find(({ textContent }) => textContent === text)?.remove();
  toasts.append(node);
  announce(text);
  setTimeout(() => node.remove(), 4000);
}

export function announce(text) {
  document.getElementById("announcer").textContent = text;
}

export async function copyText(text, message) {
  try {
    await navigator.clipboard.writeText(text);
    toast(message);
  } catch {
    // Without permission, as in a cross-site frame, the visitor copies it from a dialog.
    window.prompt("Copy this text:", text);
  }
}

/** A program, of which some words are replaced, below its title, with a button that copies it. @param {HTMLElement} program @param {Record<string, string>} words */
export function snippet({ title, textContent }, words) {
  const text = Object.entries(words).reduce((written, [word, by]) => written.replaceAll(word, by), textContent);
  const press = () => copyText(text, "Copied.");
  const copy = el("button.button.small", { text: "Copy", "aria-label": `Copy: ${title}`, press });
  return el("section.snippet", el("h3", { text: title }), copy, el("pre", el("code", { text })));
}
