// Charts by uPlot that follow the theme, say in words what they show, and can be saved as a picture.
//
// uPlot is loaded with the first chart: most visits never come to one.
import { download, el, loaded } from "./dom.js";
import { colourOf, font } from "./palette.js";

const FILES = new URL("../vendor/uplot/", import.meta.url);
const HEIGHT = 208;

/** @type {Promise<any>|null} */
let loading = null;

function loadUPlot() {
  loading ??= Promise.all([
    loaded(el("link", { rel: "stylesheet", href: new URL("uPlot.min.css", FILES) })),
    loaded(el("script", { src: new URL("uPlot.iife.min.js", FILES) })),
  ])
    .then(() => window.uPlot)
    .catch((error) => {
      loading = null;
      throw error;
    });
  return loading;
}

/**
 * @typedef {object} ChartOptions
 * @property {string} title
 * @property {string} file Name of the picture, without its ending.
 * @property {"points"|"line"} kind
 * @property {string} x What the horizontal axis counts.
 * @property {string} y What is drawn.
 * @property {(value: number) => string} format Writes a value.
 * @property {[number, number]} [range] Of the values; fitted to them where it is not given.
 * @property {number} [least] How far the axis reaches where all values are zero; 1 where it is not given.
 * @property {(index: number) => void} [pick] A value was clicked.
 */

/** One chart in a figure of its own, empty until `show`. */
export class Chart {
  /**
   * @param {HTMLElement} root
   * @param {import("./context.js").Context} context
   * @param {ChartOptions} options
   */
  constructor(root, context, options) {
    this.options = options;
    this.plot = null;
    this.summary = el("p.note");
    this.frame = el("div.chart-frame");
    this.save = el("button.button.quiet.small", {
      text: "PNG",
      "aria-label": `Save the chart "${options.title}" as PNG`,
      press: () => this.download(),
    });
    const caption = el("figcaption", el("h3", { text: options.title }), this.save, this.summary);
    this.root = el("figure.chart", { data: { chart: options.file } }, caption, this.frame);
    root.append(this.root);
    new ResizeObserver(() => this.plot && this.frame.clientWidth && this.plot.setSize(this.size())).observe(this.frame);
    context.on("theme", () => this.plot?.redraw(false, true));
  }

  /**
   * @param {(number|null)[]} values Null leaves a gap.
   * @param {string} summary What there is to see, in words.
   * @param {number[]} [at] Where they lie on the horizontal axis; counted from 1 where it is not given.
   */
  async show(values, summary, at = values.map((_, i) => i + 1)) {
    const uPlot = await loadUPlot();
    this.summary.textContent = summary;
    const data = [at, values];
    this.frame.hidden = this.save.hidden = values.every((value) => value === null);
    if (this.plot) this.plot.setData(data);
    else this.plot = this.create(uPlot, data);
  }

  create(uPlot, data) {
    const plot = new uPlot(this.settings(uPlot), data, this.frame);
    // What it shows is said by the summary.
    plot.root.setAttribute("aria-hidden", "true");
    if (this.options.pick) {
      plot.over.classList.add("can-pick");
      plot.over.addEventListener("click", () => {
        if (plot.cursor.idx !== null && plot.cursor.idx !== undefined) this.options.pick(plot.cursor.idx);
      });
    }
    return plot;
  }

  size() {
    return { width: Math.max(this.frame.clientWidth, 200), height: HEIGHT };
  }

  settings(uPlot) {
    const { kind, format, range, least = 1, x, y } = this.options;
    const accent = () => colourOf("--accent");
    const axis = {
      stroke: () => colourOf("--ink-2"),
      grid: { stroke: () => colourOf("--line"), width: 1 },
      ticks: { show: false },
      font: font(12, 400),
    };
    return {
      ...this.size(),
      padding: [8, 8, 0, 0],
      legend: { markers: { show: false } },
      cursor: { y: false, drag: { x: false, y: false }, points: { size: 9, fill: accent } },
      scales: {
        x: { time: false, range: (_, low, high) => [low - 1, high + 1] },
        // Values that are all zero would get an axis up to a hundred.
        y: {
          range:
            range ??
            ((_, low, high) =>
              low === 0 && high === 0 ? [0, least] : uPlot.rangeNum(low ?? 0, high ?? 1, 0.1, true)),
        },
      },
      axes: [
        {
          ...axis,
          size: 32,
          grid: { show: false },
          values: (_, splits) => splits.map((at) => (Number.isInteger(at) && at > 0 ? String(at) : "")),
        },
        { ...axis, size: 56, values: (_, splits) => splits.map(format) },
      ],
      series: [
        { label: x, value: (_, at) => (at === null ? "–" : String(at)) },
        {
          label: y,
          stroke: accent,
          width: kind === "line" ? 2 : 1,
          paths: kind === "points" ? () => null : undefined,
          // A line of one value cannot be seen.
          points: { show: (plot) => kind === "points" || known(plot.data[1]) === 1, size: 6, fill: accent },
          value: (_, value) => (value === null || value === undefined ? "–" : format(value)),
        },
      ],
      // A saved picture is not to be see-through.
      hooks: { drawClear: [({ ctx }) => fillBehind(ctx)] },
    };
  }

  download() {
    this.plot.ctx.canvas.toBlob((blob) => download(`${this.options.file}.png`, blob));
  }
}

const known = (values) => values.filter((value) => value !== null).length;

function fillBehind(ctx) {
  ctx.save();
  ctx.fillStyle = colourOf("--panel");
  ctx.fillRect(0, 0, ctx.canvas.width, ctx.canvas.height);
  ctx.restore();
}
