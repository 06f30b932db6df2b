// What stands out on the map: parcels, the mark of the target, the drone. Sizes are in cells, centres in device pixels.

/** A parcel that waits. */
export function drawParcel(ctx, x, y, cell, colours) {
  const half = cell * 0.31;
  const lid = half * 0.62;
  ctx.fillStyle = colours.map.shade;
  box(ctx, x - half + cell * 0.07, y - half + cell * 0.09, 2 * half, 2 * half, cell * 0.06);
  ctx.fillStyle = colours.map.box2;
  box(ctx, x - half, y - half, 2 * half, 2 * half, cell * 0.06);
  ctx.fillStyle = colours.map.box;
  box(ctx, x - half, y - half, 2 * half, half + lid, cell * 0.06);
  ctx.fillStyle = colours.map.boxInk;
  ctx.globalAlpha = 0.3;
  ctx.fillRect(x - half * 0.22, y - half, half * 0.44, half + lid);
  ctx.globalAlpha = 0.85;
  ctx.fillRect(x + half * 0.34, y + half * 0.2, half * 0.42, Math.max(1, half * 0.14));
  ctx.globalAlpha = 1;
}

/** Where a parcel has been delivered. */
export function drawDelivered(ctx, x, y, cell, colours) {
  ctx.strokeStyle = colours.map.done;
  ctx.fillStyle = colours.map.ground;
  ctx.lineWidth = Math.max(1.5, cell * 0.07);
  ctx.beginPath();
  ctx.arc(x, y, cell * 0.29, 0, 2 * Math.PI);
  ctx.fill();
  ctx.stroke();
  ctx.lineCap = ctx.lineJoin = "round";
  ctx.beginPath();
  ctx.moveTo(x - cell * 0.13, y + cell * 0.01);
  ctx.lineTo(x - cell * 0.03, y + cell * 0.11);
  ctx.lineTo(x + cell * 0.14, y - cell * 0.1);
  ctx.stroke();
}

/** Brackets around the current target. `breath` in [0, 1] opens them a little. */
export function drawTarget(ctx, x, y, cell, breath, colours) {
  const half = cell * (0.47 + 0.07 * breath);
  const arm = cell * 0.2;
  ctx.strokeStyle = colours.accent;
  ctx.lineWidth = Math.max(1.5, cell * 0.065);
  ctx.lineCap = "square";
  ctx.beginPath();
  for (const sx of [-1, 1]) {
    for (const sy of [-1, 1]) {
      ctx.moveTo(x + sx * half, y + sy * (half - arm));
      ctx.lineTo(x + sx * half, y + sy * half);
      ctx.lineTo(x + sx * (half - arm), y + sy * half);
    }
  }
  ctx.stroke();
}

/**
 * The drone from above.
 *
 * @param {number} size Its width in device pixels. @param {number} heading Radians, 0 is up.
 * @param {number} spin Angle of the rotors. @param {number} lift 0 on the ground, 1 in flight: how far its shadow lies.
 */
export function drawDrone(ctx, x, y, size, heading, spin, lift, colours) {
  const arm = size * 0.33;
  const rotor = size * 0.2;
  ctx.fillStyle = colours.map.shade;
  ctx.beginPath();
  const away = size * (0.06 + 0.12 * lift);
  for (const [sx, sy] of CORNERS) {
    ctx.moveTo(x + away + sx * arm + rotor, y + away + sy * arm);
    ctx.arc(x + away + sx * arm, y + away + sy * arm, rotor, 0, 2 * Math.PI);
  }
  ctx.moveTo(x + away + size * 0.16, y + away);
  ctx.arc(x + away, y + away, size * 0.16, 0, 2 * Math.PI);
  ctx.fill();

  ctx.lineCap = "round";
  ctx.strokeStyle = colours.map.hull;
  ctx.lineWidth = size * 0.075;
  ctx.beginPath();
  ctx.moveTo(x - arm, y - arm);
  ctx.lineTo(x + arm, y + arm);
  ctx.moveTo(x + arm, y - arm);
  ctx.lineTo(x - arm, y + arm);
  ctx.stroke();

  // The discs that the rotors sweep, and the blades in them.
  ctx.fillStyle = colours.map.hull;
  ctx.globalAlpha = 0.2;
  ctx.beginPath();
  for (const [sx, sy] of CORNERS) {
    ctx.moveTo(x + sx * arm + rotor, y + sy * arm);
    ctx.arc(x + sx * arm, y + sy * arm, rotor, 0, 2 * Math.PI);
  }
  ctx.fill();
  ctx.globalAlpha = 1;
  ctx.strokeStyle = colours.accent;
  ctx.lineWidth = Math.max(1.2, size * 0.045);
  ctx.stroke();
  ctx.strokeStyle = colours.map.hull;
  ctx.lineWidth = Math.max(1, size * 0.04);
  ctx.beginPath();
  for (const [sx, sy] of CORNERS) {
    const turn = spin * sx * sy + (sx + sy) * 0.4;
    const dx = Math.cos(turn) * rotor * 0.82;
    const dy = Math.sin(turn) * rotor * 0.82;
    ctx.moveTo(x + sx * arm - dx, y + sy * arm - dy);
    ctx.lineTo(x + sx * arm + dx, y + sy * arm + dy);
  }
  ctx.stroke();

  ctx.fillStyle = colours.map.hull;
  ctx.beginPath();
  ctx.arc(x, y, size * 0.17, 0, 2 * Math.PI);
  ctx.fill();
  // The nose says where it flies.
  const noseX = x + Math.sin(heading) * size * 0.075;
  const noseY = y - Math.cos(heading) * size * 0.075;
  ctx.fillStyle = colours.accent;
  ctx.beginPath();
  ctx.arc(noseX, noseY, size * 0.065, 0, 2 * Math.PI);
  ctx.fill();
}

const CORNERS = [
  [-1, -1],
  [1, -1],
  [-1, 1],
  [1, 1],
];

/** Another drone that is only thought of: the one on the best flight. */
export function drawGhost(ctx, x, y, size, colours) {
  const arm = size * 0.3;
  ctx.strokeStyle = colours.map.ghost;
  ctx.lineWidth = Math.max(1.2, size * 0.055);
  ctx.beginPath();
  for (const [sx, sy] of CORNERS) {
    ctx.moveTo(x, y);
    ctx.lineTo(x + sx * arm * 0.6, y + sy * arm * 0.6);
    ctx.moveTo(x + sx * arm + size * 0.16, y + sy * arm);
    ctx.arc(x + sx * arm, y + sy * arm, size * 0.16, 0, 2 * Math.PI);
  }
  ctx.stroke();
}

/** An arrow from one point to another, thick at its head. */
export function drawArrow(ctx, x1, y1, x2, y2, width) {
  const length = Math.hypot(x2 - x1, y2 - y1);
  if (length < 1) return;
  const ux = (x2 - x1) / length;
  const uy = (y2 - y1) / length;
  const head = Math.min(length, width * 2.2);
  const neckX = x2 - ux * head;
  const neckY = y2 - uy * head;
  ctx.beginPath();
  ctx.moveTo(x1 - uy * width * 0.35, y1 + ux * width * 0.35);
  ctx.lineTo(neckX - uy * width * 0.5, neckY + ux * width * 0.5);
  ctx.lineTo(neckX - uy * width * 1.25, neckY + ux * width * 1.25);
  ctx.lineTo(x2, y2);
  ctx.lineTo(neckX + uy * width * 1.25, neckY - ux * width * 1.25);
  ctx.lineTo(neckX + uy * width * 0.5, neckY - ux * width * 0.5);
  ctx.lineTo(x1 + uy * width * 0.35, y1 - ux * width * 0.35);
  ctx.fill();
}

/** A chess player's mark (`?!`, `?`, `??`, `!!`) in a disc. */
export function drawMark(ctx, x, y, size, mark, colour, colours) {
  ctx.fillStyle = colour;
  ctx.beginPath();
  ctx.arc(x, y, size * 0.5, 0, 2 * Math.PI);
  ctx.fill();
  ctx.fillStyle = colours.ground;
  ctx.font = `600 ${size * 0.62}px ${colours.font}`;
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  ctx.fillText(mark, x, y + size * 0.04);
}

function box(ctx, x, y, w, h, radius) {
  ctx.beginPath();
  ctx.roundRect(x, y, w, h, radius);
  ctx.fill();
}
