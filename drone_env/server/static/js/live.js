// The socket to the server: messages both ways, and a connection that comes back by itself.
import { address } from "./api.js";
import { Emitter } from "./base.js";

const WAITS = [500, 1000, 2000, 4000, 8000];
const NOT_ALLOWED = 1008;
const TRY_LATER = 1013;
/** A connection that lasts so long, in milliseconds, is a good one. */
const STEADY = 10_000;

/**
 * @typedef {"connecting"|"open"|"away"|"full"|"refused"} LinkState
 *
 * Events: every message type of the server ("flights", "frames", ...) with the message, and "state" with
 * {state: LinkState, wait: milliseconds until the next try, reason}.
 */
export class Live extends Emitter {
  /** @param {() => string[]} protocols What the socket offers so that it is let in. */
  constructor(protocols) {
    super();
    this.protocols = protocols;
    this.topics = [];
    this.state = "connecting";
    this.failures = 0;
    this.timer = 0;
    this.steady = 0;
    this.socket = null;
  }

  /** Connects, or connects again at once. */
  connect() {
    clearTimeout(this.timer);
    clearTimeout(this.steady);
    if (this.socket) this.socket.onclose = this.socket.onmessage = this.socket.onopen = null;
    this.socket?.close();
    const url = address("live");
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    url.search = url.hash = "";
    const socket = new WebSocket(url, this.protocols());
    this.socket = socket;
    // A server that is full says so only now: one that has answered has room. Nothing flies on a new connection.
    socket.onopen = () => this.send({ type: "pause" });
    socket.onmessage = (event) => {
      if (this.state !== "open") this.opened();
      const message = JSON.parse(event.data);
      this.emit(message.type, message);
    };
    socket.onclose = (event) => this.closed(event);
  }

  /** Sends a message; false where there is no connection. */
  send(message) {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** Asks for these topics alone, of "requests", "training" and "episodes", now and whenever it connects anew. */
  subscribe(topics) {
    this.topics = topics;
    this.send({ type: "subscribe", topics });
  }

  opened() {
    this.steady = setTimeout(() => {
      this.failures = 0;
    }, STEADY);
    this.change("open", 0, "");
    if (this.topics.length) this.subscribe(this.topics);
  }

  closed(event) {
    if (event.code === NOT_ALLOWED) {
      this.change("refused", 0, event.reason);
      return;
    }
    clearTimeout(this.steady);
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
