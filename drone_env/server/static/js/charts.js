/**
 * Charts by uPlot that follow the theme, say in words what they show, and can be saved as a picture.
 *
 * uPlot is loaded with the first chart: most visits never come to one.
 */

const FILES = new URL("../vendor/uplot/", import.meta.url);
const HEIGHT = 200;
const FONT = '12px system-ui, "Segoe UI", sans-serif';

/** @type {Promise<any>|null} */
let loading = null;

function loadUPlot() {
  loading ??= Promise.all([stylesheet("uPlot.min.css"), script("uPlot.iife.min.js")])
    .then(() => /** @type {any} */ (window).uPlot)
    .catch((error) => {
      loading = null;
      throw error;
    });
  return loading;
}

function added(element) {
  return new Promise((resolve, reject) => {
    element.addEventListener("load", resolve);
    element.addEventListener("error", () => reject(new Error("The charts could not be loaded from the server.")));
    document.head.append(element);
  });
}

function stylesheet(file) {
  const link = document.createElement("link");
  link.rel = "stylesheet";
  link.href = new URL(file, FILES).href;
  return added(link);
}

function script(file) {
  const element = document.createElement("script");
  element.src = new URL(file, FILES).href;
  return added(element);
}

/** The value of a design token now, such as `--accent`. */
function token(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/**
 * @typedef {object} ChartOptions
 * @property {string} title
 * @property {string} file Name of the picture, without ending.
 * @property {"points"|"line"|"bars"} kind
 * @property {string} series Name of what is drawn.
 * @property {string} x Name of the horizontal axis.
 * @property {(value: number) => string} format Of values.
 * @property {[number, number]} [range] Of values; fitted where not given.
 * @property {(index: number) => void} [pick] A value was clicked.
 */

/** One chart in a figure of its own. `show` draws; nothing is there before. */
export class Chart {
  /**
   * @param {HTMLElement} root
   * @param {ChartOptions} options
   */
  constructor(root, options) {
    this.options = options;
    this.figure = document.createElement("figure");
    this.figure.className = "chart";
    const caption = document.createElement("figcaption");
    const title = document.createElement("h4");
    title.textContent = options.title;
    this.summary = document.createElement("p");
    this.save = document.createElement("button");
    this.save.type = "button";
    this.save.className = "quiet";
    this.save.textContent = "PNG";
    this.save.setAttribute("aria-label", `Save the chart ${options.title} as PNG`);
    this.save.addEventListener("click", () => this.download());
    caption.append(title, this.save, this.summary);
    this.frame = document.createElement("div");
    this.frame.className = "chart-frame";
    this.figure.append(caption, this.frame);
    root.append(this.figure);
    this.plot = null;
    this.names = null;
    new ResizeObserver(() => this.plot?.setSize(this.size())).observe(this.frame);
    onTheme(() => this.plot?.redraw(false, true));
  }

  /**
   * Draw values; a value that is null leaves a gap.
   *
   * @param {(number|null)[]} values
   * @param {string} summary What there is to see, for those who do not.
   * @param {string[]|null} names Of the values, under bars.
   */
  async show(values, summary, names = null) {
    const uPlot = await loadUPlot();
    this.summary.textContent = summary;
    this.frame.hidden = this.save.hidden = values.length === 0;
    const positions = values.map((_, index) => (names ? index : index + 1));
    this.names = names;
    if (this.plot) {
      this.plot.setData([positions, values]);
      return;
    }
    this.plot = new uPlot(this.settings(uPlot), [positions, values], this.frame);
    // What it shows stands in the summary, as text.
    this.plot.root.setAttribute("aria-hidden", "true");
    this.plot.over.addEventListener("click", () => {
      const { idx } = this.plot.cursor;
      if (idx !== null && idx !== undefined) this.options.pick?.(idx);
    });
    this.plot.over.classList.toggle("can-pick", Boolean(this.options.pick));
  }

  size() {
    return { width: Math.max(this.frame.clientWidth, 160), height: HEIGHT };
  }

  settings(uPlot) {
    const { kind, format, range, series, x } = this.options;
    const bars = kind === "bars";
    const axis = {
      stroke: () => token("--text-2"),
      grid: { stroke: () => token("--line"), width: 1 },
      ticks: { show: false },
      font: FONT,
    };
    const drawn = {
      label: series,
      stroke: () => token("--accent"),
      width: kind === "line" ? 2 : 1,
      fill: bars ? () => token("--accent") : undefined,
      paths: bars ? uPlot.paths.bars({ size: [0.6, 64] }) : kind === "points" ? () => null : undefined,
      points: { show: kind === "points", size: 5, fill: () => token("--accent") },
      value: (_, value) => (value === null || value === undefined ? "–" : format(value)),
    };
    return {
      ...this.size(),
      legend: { live: true, markers: { show: false } },
      cursor: { drag: { x: !bars, y: false }, y: false },
      scales: {
        x: { time: false, range: bars ? (_, low, high) => [low - 0.5, high + 0.5] : undefined },
        y: range ? { range } : { range: (_, low, high) => uPlot.rangeNum(low ?? 0, high ?? 1, 0.1, true) },
      },
      axes: [
        {
          ...axis,
          grid: { show: false },
          splits: bars ? () => this.names.map((_, index) => index) : undefined,
          values: bars ? () => this.names : (_, splits) => splits.map((at) => (Number.isInteger(at) ? String(at) : "")),
        },
        { ...axis, size: 56, values: (_, splits) => splits.map(format) },
      ],
      series: [{ label: x, value: (_, at) => (at === null ? "–" : bars ? this.names[at] : String(at)) }, drawn],
      hooks: { drawClear: [(plot) => background(plot.ctx)] },
    };
  }

  download() {
    this.plot?.ctx.canvas.toBlob((blob) => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = `${this.options.file}.png`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
  }
}

/** So that a saved picture is not see-through. */
function background(context) {
  context.save();
  context.fillStyle = token("--surface");
  context.fillRect(0, 0, context.canvas.width, context.canvas.height);
  context.restore();
}

/** Call `redraw` whenever the page turns dark or light. */
function onTheme(redraw) {
  new MutationObserver(redraw).observe(document.documentElement, { attributeFilter: ["data-theme", "class"] });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}
