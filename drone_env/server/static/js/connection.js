// Says how the connection is: a dot in the top bar, and a banner while the server is away.
import { announce, setText } from "./dom.js";

const WORDS = { connecting: "Connecting", open: "Live", away: "Server away", full: "Server full", refused: "Refused" };

/** @param {import("./context.js").Context} context */
export function mountConnection({ live, stage }) {
  const dot = document.getElementById("connection");
  const banner = document.getElementById("banner");
  const text = document.getElementById("banner-text");
  const again = document.getElementById("banner-countdown");
  let countdown = 0;

  document.getElementById("banner-retry").addEventListener("click", () => live.connect());
  live.on("state", ({ state, wait, reason }) => {
    clearInterval(countdown);
    dot.dataset.state = state === "open" || state === "connecting" ? state : "away";
    setText(dot.lastElementChild, WORDS[state]);
    if (state === "open") {
      if (!banner.hidden) announce("The server is back.");
      banner.hidden = true;
      return;
    }
    const why = reason ? ` (${reason})` : "";
    const kept = stage.tracks.some((track) => track.live && !track.done) ? " Your flight is kept." : "";
    const until = Date.now() + wait;
    const words = {
      refused: `The server refused the connection${why}.`,
      full: `The server is full${why}.`,
      away: `The server is away${why}.${kept}`,
    };
    setText(text, words[state]);
    // Counted down for the eye alone: a screen reader would say every second of it.
    const say = () => {
      const seconds = Math.ceil((until - Date.now()) / 1000);
      setText(again, state === "refused" ? "" : seconds > 0 ? `Trying again in ${seconds} s …` : "Trying again …");
    };
    say();
    banner.hidden = false;
    if (wait) countdown = setInterval(say, 500);
  });
}
