// The map as an image, and its flights as a film.
import { colourOf, font } from "./base.js";
import { fitted } from "./camera.js";
import { download, el, onPress, setText } from "./dom.js";
import { title } from "./format.js";
import { LAYERS } from "./layers.js";

/** Side of a map in pixels, and pixels per CSS pixel. */
const IMAGE = { side: 1200, scale: 2 };
const FILM = { side: 480, scale: 1 };
const LINE = 20;
const MILLISECONDS = 125;
const REST = 2000;

/** @param {HTMLElement} root @param {Context} context */
export function mountPictures(root, context) {
  const { stage } = context;
  const [image, film] = root.querySelectorAll("button");
  onPress(root, { "save-image": saveImage, "save-film": saveFilm });
  let saving = false;
  const name = (suffix) => `drone-${stage.world.task.short_name}-${stage.world.seed}.${suffix}`;

  async function saveImage() {
    const { canvas, draw } = painter(context, IMAGE, LAYERS);
    draw(stage.clock.cursor);
    const file = name("png");
    canvas.toBlob((blob) => download(file, blob));
  }

  async function saveFilm() {
    const file = name("gif");
    const steps = stage.clock.end();
    // The layers of the cells are known for one moment only.
    const { canvas, draw } = painter(context, FILM, LAYERS.filter(({ place }) => place !== "cells"));
    const { width, height } = canvas;
    saving = true;
    update();
    try {
      const { GIFEncoder, applyPalette, quantize } = await import("../vendor/gifenc/gifenc.js");
      const palette = quantize(new Uint8Array([...draw(0), ...draw(steps)]), 255);
      const unchanged = palette.push([0, 0, 0]) - 1;
      const gif = GIFEncoder();
      let before = null;
      for (let step = 0; step <= steps; step++) {
        const now = applyPalette(draw(step), palette);
        const index = before ? now.map((colour, i) => (colour === before[i] ? unchanged : colour)) : now;
        const options = { transparent: Boolean(before), transparentIndex: unchanged, dispose: 1 };
        gif.writeFrame(index, width, height, { ...options, palette: before ? null : palette, delay: step < steps ? MILLISECONDS : REST });
        before = now;
        setText(film, `Film: ${Math.floor((100 * step) / steps)} %`);
        await new Promise((resolve) => setTimeout(resolve));
      }
      gif.finish();
      download(file, new Blob([gif.bytes()], { type: "image/gif" }));
    } finally {
      saving = false;
      setText(film, "Save film");
      update();
    }
  }

  function update() {
    image.disabled = !stage.world;
    film.disabled = saving || stage.clock.end() === 0;
  }
  stage.on("change", update);
}

/** Draws layers of the present map and flights as at a step, with what was flown below; returns the pixels. @param {Context} context */
function painter(context, { side, scale }, layers) {
  const { stage } = context;
  const { world, track, tracks } = stage;
  const { attribution } = world.task;
  const canvas = el("canvas", { width: side, height: side + ((attribution ? 3 : 2) * LINE + 8) * scale });
  const ctx = canvas.getContext("2d", { willReadFrequently: true });
  const size = { width: side, height: side, scale };
  const view = { size, stage, world, track, tracks, names: context.names, layout: fitted(world, size), spin: 0 };
  const shown = layers.filter((layer) => context.shows(layer.id));
  const paint = (pen, place, clock) => {
    for (const layer of shown) if (layer.place === place) layer.draw(pen, { ...view, clock });
  };
  const ground = el("canvas", { width: side, height: side });
  paint(ground.getContext("2d"), "ground");
  function draw(step) {
    const clock = { cursor: step, position: step };
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.fillStyle = colourOf("--ground");
    ctx.fillRect(0, 0, side, canvas.height);
    ctx.drawImage(ground, 0, 0);
    paint(ctx, "cells", clock);
    paint(ctx, "air", clock);
    ctx.globalAlpha = 1;
    ctx.font = font(13 * scale);
    ctx.textBaseline = "alphabetic";
    ctx.textAlign = "left";
    ctx.fillStyle = colourOf("--ink");
    const { step: at, battery_units: units, deliveries_done: done } = track.frameAt(step);
    const texts = [
      `${title(world.task.short_name)}, map ${world.seed}: ${track.name}`,
      `step ${at} · battery ${units} of ${world.battery_capacity} · ${done} of ${world.parcels.length} parcels`,
      attribution,
    ];
    texts.forEach((text, i) => ctx.fillText(text, 8 * scale, side + (i + 1) * LINE * scale));
    return ctx.getImageData(0, 0, side, canvas.height).data;
  }
  return { canvas, draw };
}
