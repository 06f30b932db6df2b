// Slider, buttons and speed of a flight of the past.
import { el, icon, setText } from "./dom.js";
import { fixed, signed, title } from "./format.js";

const SPEEDS = [1, 2, 6, 15, 30];
const PLAY = icon("!M8 5.5v13l11-6.5z");
const PAUSE = icon("!M7 5.5h3.5v13H7z", "!M13.5 5.5H17v13h-3.5z");

export class Transport {
  /** @param {import("./player.js").Player} player */
  constructor(player) {
    this.player = player;
    const button = (label, key, drawing, press) =>
      el(
        "button.icon-button",
        {
          "aria-label": label,
          title: `${label} (${key})`,
          press,
        },
        drawing,
      );
    this.slider = el("input", {
      type: "range",
      id: "replay-slider",
      min: "0",
      max: "0",
      step: "1",
      value: "0",
      "aria-label": "Step of the flight",
      on: { input: () => player.seek(Number(this.slider.value)) },
    });
    this.first = button("First step", "Home", icon("M18 6l-7 6 7 6", "M6.5 6v12"), () => player.seek(0));
    this.back = button("Step back", "←", icon("M15 6l-7 6 7 6"), () => this.step(-1));
    this.toggle = button("Play", "Space", PLAY, () => this.playOrPause());
    this.forward = button("Step forward", "→", icon("M9 6l7 6-7 6"), () => this.step(1));
    this.end = button("Last step", "End", icon("M6 6l7 6-7 6", "M17.5 6v12"), () => player.seek(Infinity));
    this.speed = el(
      "select",
      {
        id: "replay-speed",
        on: {
          change: () => {
            player.speed = Number(this.speed.value);
          },
        },
      },
      ...SPEEDS.map((speed) => el("option", { value: String(speed), text: `${speed} steps/s` })),
    );
    this.speed.value = String(player.speed);
    this.where = el("p.replay-step", { id: "replay-step" });
    this.root = el(
      "div.transport",
      this.slider,
      el(
        "div.transport-row",
        el(
          "div.transport-buttons",
          { role: "group", "aria-label": "Playback" },
          this.first,
          this.back,
          this.toggle,
          this.forward,
          this.end,
        ),
        el("label", { for: "replay-speed" }, el("span.visually-hidden", { text: "Speed" }), this.speed),
        this.where,
      ),
    );
    player.on("change", () => this.draw());
  }

  step(by) {
    this.player.stop();
    this.player.seek(this.player.cursor + by);
  }

  playOrPause() {
    if (this.player.playing) this.player.stop();
    else this.player.play();
  }

  /** What a key does; true if it does something. */
  press(key) {
    const acts = {
      ArrowLeft: () => this.step(-1),
      ArrowRight: () => this.step(1),
      Home: () => this.player.seek(0),
      End: () => this.player.seek(Infinity),
      " ": () => this.playOrPause(),
    };
    acts[key]?.();
    return key in acts;
  }

  draw() {
    const { player } = this;
    if (player.empty) return;
    const last = player.frames.length - 1;
    this.slider.max = String(last);
    this.slider.value = String(player.cursor);
    const said = sentence(player.frame, last);
    this.slider.setAttribute("aria-valuetext", said);
    setText(this.where, said);
    this.first.disabled = this.back.disabled = player.cursor === 0;
    this.end.disabled = this.forward.disabled = player.cursor === last;
    this.toggle.setAttribute("aria-label", player.playing ? "Pause" : "Play");
    this.toggle.replaceChildren(player.playing ? PAUSE : PLAY);
  }
}

/** A frame in words: `Step 12 of 35 · LEFT · Delivery · reward +0.90`. */
function sentence(frame, last) {
  const parts = [`Step ${frame.step} of ${last}`];
  if (frame.action) parts.push(frame.action, title(frame.event), `reward ${signed(frame.reward)}`);
  parts.push(`total ${fixed(frame.reward_total)}`);
  return parts.join(" · ");
}
