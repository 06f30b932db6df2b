// The WebSocket to the server, which reconnects by itself.
import { address } from "./api.js";
import { Emitter } from "./base.js";

const WAITS = [500, 1000, 2000, 4000, 8000];
const NOT_ALLOWED = 1008;
const TRY_LATER = 1013;

/** Events: every message type of the server with the message, and "state" ({state, wait: ms until the next try, reason}). */
export class Live extends Emitter {
  /** @param {() => string[]} protocols Subprotocols, with the token if there is one. */
  constructor(protocols) {
    super();
    this.protocols = protocols;
    this.topics = [];
    this.state = "connecting";
    this.failures = 0;
    this.timer = 0;
    this.socket = null;
  }

  /** Connects, or reconnects at once. */
  connect() {
    clearTimeout(this.timer);
    if (this.socket) this.socket.onclose = this.socket.onmessage = this.socket.onopen = null;
    this.socket?.close();
    const url = address("live");
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    url.search = url.hash = "";
    const socket = new WebSocket(url, this.protocols());
    this.socket = socket;
    // A full server accepts the connection and then closes it: only an answer proves that there is room.
    socket.onopen = () => this.send({ type: "pause" });
    socket.onmessage = (event) => {
      if (this.state !== "open") {
        this.failures = 0;
        this.change("open", 0, "");
        if (this.topics.length) this.subscribe(this.topics);
      }
      const message = JSON.parse(event.data);
      this.emit(message.type, message);
    };
    socket.onclose = (event) => this.closed(event);
  }

  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** Subscribes to these topics only, also after a reconnect: "requests", "training", "episodes". */
  subscribe(topics) {
    this.topics = topics;
    this.send({ type: "subscribe", topics });
  }

  closed(event) {
    if (event.code === NOT_ALLOWED) {
      this.change("refused", 0, event.reason);
      return;
    }
    const wait = WAITS[Math.min(this.failures, WAITS.length - 1)];
    this.failures += 1;
    this.timer = setTimeout(() => this.connect(), wait);
    this.change(event.code === TRY_LATER ? "full" : "away", wait, event.reason);
  }

  change(state, wait, reason) {
    this.state = state;
    this.emit("state", { state, wait, reason });
  }
}
