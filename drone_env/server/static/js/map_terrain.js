// What does not move: ground, streets' grid, buildings, trees, barriers, pads. Drawn once per map, size and theme.

/**
 * @typedef {Object} Layout Where the grid lies on the canvas, in device pixels.
 * @property {number} cell Side of a cell, whole.
 * @property {number} left @property {number} top Corner of cell [0, 0].
 * @property {number} scale Device pixels per CSS pixel.
 * @property {boolean} labels Whether there is room for the numbers of columns and rows.
 */

/** @param {CanvasRenderingContext2D} ctx @param {Layout} layout @param {string[]} names Kinds of cells by id. */
export function drawTerrain(ctx, mission, layout, names, colours) {
  const { cell, left, top } = layout;
  const width = mission.width * cell;
  const height = mission.height * cell;
  ctx.fillStyle = colours.map.ground;
  ctx.fillRect(left, top, width, height);
  drawGrid(ctx, mission, layout, colours);
  if (layout.labels) drawLabels(ctx, mission, layout, colours);
  // Shadows first, so that none falls on a neighbour's roof.
  for (const shadow of [true, false]) {
    for (let y = 0; y < mission.height; y++) {
      for (let x = 0; x < mission.width; x++) {
        const paint = PAINTERS[names[mission.cells[y][x]]];
        if (paint) paint(ctx, left + x * cell, top + y * cell, cell, noise(x, y, mission.seed), colours.map, shadow);
      }
    }
  }
}

const PAINTERS = { building: drawBuilding, tree: drawTree, obstacle: drawBarrier, pad: drawPad };

/** One cell of terrain with its shadow; nothing where the kind has no sign. */
export function drawKind(ctx, name, x, y, cell, noise, colours) {
  for (const shadow of [true, false]) PAINTERS[name]?.(ctx, x, y, cell, noise, colours, shadow);
}

/** Three numbers in [0, 1) that belong to a cell: the same city always looks the same. */
function noise(x, y, seed) {
  let h = (x * 374761393 + y * 668265263 + (seed % 65521) * 2246822519) | 0;
  return [0, 1, 2].map(() => {
    h = Math.imul(h ^ (h >>> 13), 1274126177);
    h ^= h >>> 16;
    return (h >>> 0) / 4294967296;
  });
}

function drawGrid(ctx, mission, { cell, left, top, scale }, colours) {
  ctx.strokeStyle = colours.map.grid;
  const line = Math.max(1, Math.round(scale));
  ctx.lineWidth = line;
  const half = (line % 2) / 2;
  ctx.beginPath();
  for (let x = 1; x < mission.width; x++) {
    ctx.moveTo(left + x * cell + half, top);
    ctx.lineTo(left + x * cell + half, top + mission.height * cell);
  }
  for (let y = 1; y < mission.height; y++) {
    ctx.moveTo(left, top + y * cell + half);
    ctx.lineTo(left + mission.width * cell, top + y * cell + half);
  }
  ctx.stroke();
  ctx.strokeStyle = colours.map.edge;
  ctx.strokeRect(left - half, top - half, mission.width * cell + 2 * half, mission.height * cell + 2 * half);
}

function drawLabels(ctx, mission, { cell, left, top, scale }, colours) {
  ctx.fillStyle = colours.map.label;
  ctx.font = `500 ${11 * scale}px ${colours.font}`;
  ctx.textAlign = "center";
  ctx.textBaseline = "alphabetic";
  for (let x = 0; x < mission.width; x++) ctx.fillText(String(x), left + (x + 0.5) * cell, top - 6 * scale);
  ctx.textAlign = "right";
  ctx.textBaseline = "middle";
  for (let y = 0; y < mission.height; y++) ctx.fillText(String(y), left - 6 * scale, top + (y + 0.53) * cell);
}

function drawBuilding(ctx, x, y, cell, [tall, shape, detail], colours, shadow) {
  const inset = Math.round(cell * 0.06);
  const w = cell - 2 * inset;
  const h = cell - 2 * inset;
  const rise = Math.round(cell * (0.16 + 0.16 * tall));
  const radius = cell * 0.05;
  if (shadow) {
    const cast = cell * (0.08 + 0.1 * tall);
    ctx.fillStyle = colours.shade;
    box(ctx, x + inset + cast, y + inset + cast * 0.7, w, h, radius);
    return;
  }
  // The front below, the roof above it: one sees the city a little from the south.
  const roof = h - rise;
  ctx.fillStyle = colours.wall;
  box(ctx, x + inset, y + inset, w, h, radius);
  if (cell > 16) windows(ctx, x + inset, y + inset + roof, w, rise, cell, detail, colours);
  ctx.fillStyle = colours.roof;
  box(ctx, x + inset, y + inset, w, roof, radius);
  ctx.fillStyle = colours.roof2;
  ctx.fillRect(x + inset + radius, y + inset, w - 2 * radius, Math.max(1, Math.round(cell * 0.045)));
  if (shape < 0.4) {
    box(ctx, x + inset + w * (0.16 + 0.3 * detail), y + inset + roof * 0.32, w * 0.36, roof * 0.4, radius / 2);
  } else if (shape < 0.7) {
    box(ctx, x + inset + w * 0.14, y + inset + roof * 0.3, w * 0.22, roof * 0.24, radius / 2);
    box(ctx, x + inset + w * 0.48, y + inset + roof * 0.5, w * 0.34, roof * 0.24, radius / 2);
  } else if (cell > 20) {
    ctx.strokeStyle = colours.roof2;
    ctx.lineWidth = Math.max(1, cell * 0.04);
    ctx.strokeRect(x + inset + w * 0.16, y + inset + roof * 0.26, w * 0.68, roof * 0.5);
  }
}

/** A row of windows, some of them lit. */
function windows(ctx, x, y, w, rise, cell, detail, colours) {
  const size = Math.max(1, Math.round(cell * 0.07));
  const count = 5;
  const gap = w / count;
  const top = Math.round(y + (rise - size * 1.3) / 2);
  for (let i = 0; i < count; i++) {
    const lit = Math.floor(detail * 32) & (1 << i);
    ctx.fillStyle = lit ? colours.window : colours.roof;
    ctx.globalAlpha = lit ? 0.85 : 0.6;
    ctx.fillRect(Math.round(x + gap * (i + 0.5) - size / 2), top, size, Math.round(size * 1.3));
  }
  ctx.globalAlpha = 1;
}

function drawTree(ctx, x, y, cell, [a, b, c], colours, shadow) {
  const crown = (dx, dy, r, colour) => {
    ctx.fillStyle = colour;
    ctx.beginPath();
    ctx.arc(x + cell * dx, y + cell * dy, cell * r, 0, 2 * Math.PI);
    ctx.fill();
  };
  const lean = 0.08 * (a - 0.5);
  if (shadow) {
    crown(0.58 + lean, 0.6, 0.32, colours.shade);
    return;
  }
  crown(0.5 + lean, 0.5, 0.31, colours.leaf);
  crown(0.38 + lean, 0.6, 0.18, colours.leaf);
  crown(0.64 + lean, 0.58, 0.17 + 0.03 * b, colours.leaf);
  crown(0.44 + lean, 0.42, 0.17, colours.leaf2);
  crown(0.6 + lean, 0.5 + 0.08 * c, 0.08, colours.leaf2);
}

function drawBarrier(ctx, x, y, cell, _, colours, shadow) {
  const left = x + cell * 0.12;
  const w = cell * 0.76;
  const high = cell * 0.24;
  const top = y + cell * 0.34;
  if (shadow) {
    ctx.fillStyle = colours.shade;
    box(ctx, left + cell * 0.07, top + cell * 0.12, w, high + cell * 0.14, cell * 0.04);
    return;
  }
  ctx.fillStyle = colours.wall;
  for (const dx of [0.14, 0.76]) ctx.fillRect(left + w * dx, top - cell * 0.06, w * 0.1, high + cell * 0.26);
  ctx.save();
  ctx.beginPath();
  ctx.roundRect(left, top, w, high, cell * 0.05);
  ctx.clip();
  ctx.fillStyle = colours.barrier;
  ctx.fillRect(left, top, w, high);
  ctx.fillStyle = colours.barrier2;
  const stripe = w / 6;
  for (let i = -1; i < 7; i += 2) {
    ctx.beginPath();
    ctx.moveTo(left + i * stripe, top + high);
    ctx.lineTo(left + (i + 1) * stripe, top + high);
    ctx.lineTo(left + (i + 2) * stripe, top);
    ctx.lineTo(left + (i + 1) * stripe, top);
    ctx.fill();
  }
  ctx.restore();
}

function drawPad(ctx, x, y, cell, _, colours, shadow) {
  if (shadow) return;
  const inset = cell * 0.1;
  ctx.fillStyle = colours.pad;
  box(ctx, x + inset, y + inset, cell - 2 * inset, cell - 2 * inset, cell * 0.16);
  ctx.strokeStyle = colours.padInk;
  ctx.lineWidth = Math.max(1, cell * 0.045);
  ctx.beginPath();
  ctx.arc(x + cell / 2, y + cell / 2, cell * 0.31, 0, 2 * Math.PI);
  ctx.stroke();
  ctx.fillStyle = colours.padInk;
  ctx.beginPath();
  for (const [dx, dy] of [
    [0.55, 0.28],
    [0.37, 0.54],
    [0.49, 0.54],
    [0.45, 0.72],
    [0.63, 0.46],
    [0.51, 0.46],
  ]) {
    ctx.lineTo(x + cell * dx, y + cell * dy);
  }
  ctx.fill();
}

function box(ctx, x, y, w, h, radius) {
  ctx.beginPath();
  ctx.roundRect(x, y, w, h, radius);
  ctx.fill();
}
