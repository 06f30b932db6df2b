// Draws one flight on a canvas. Shared by Watch, Race and Replay.

export class CityMap {
  /**
   * @param {HTMLElement} root Filled with the canvases; its size is the map's size, kept square cells.
   * @param {import("./player.js").Player} player What is drawn: the map redraws by itself whenever the player changes.
   * @param {import("./context.js").Context} context For the kinds of cells and the theme.
   */
  constructor(root, player, context) {
    this.root = root;
    this.player = player;
    this.context = context;
    /** Shows the network's values of the actions as arrows. */
    this.showValues = true;
    /** [x, y] of a best flight, drawn as a ghost; null for none. */
    this.ghost = null;
  }

  /** Draws again, after `showValues` or `ghost` were set. */
  refresh() {}

  /** Ends the drawing and the listening. */
  destroy() {}

  /** The map as it stands, as a PNG. @returns {Promise<Blob>} */
  async png() { return new Blob(); }
}
