// Whoever has something to tell: the page's parts hear of one another by this alone.

export class Emitter {
  constructor() {
    this.listeners = new Map();
  }

  /** Calls f at every event; returns a function that ends that. */
  on(type, f) {
    if (!this.listeners.has(type)) this.listeners.set(type, new Set());
    this.listeners.get(type).add(f);
    return () => this.listeners.get(type).delete(f);
  }

  /** Tells it to all who listen. */
  emit(type, ...args) {
    for (const f of this.listeners.get(type) ?? []) f(...args);
  }
}
