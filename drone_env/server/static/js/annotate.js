// Fetches what each move of a finished flight gave away, and puts it on its player.
import { ApiError } from "./api.js";

/**
 * @param {import("./context.js").Context} context @param {import("./player.js").Player} player Its `episode` is stored.
 * @returns {Promise<string|null>} null when it is there, else why it cannot be.
 */
export async function annotate({ api }, player) {
  const { episode } = player;
  if (!episode) return "The flight is not stored yet.";
  if (player.annotation) return null;
  try {
    const record = await api.get(`episodes/${encodeURIComponent(episode.id)}`);
    const annotation = await api.post("annotate", record);
    // Another mission may have begun meanwhile.
    if (player.episode === episode) player.annotate(annotation);
    return null;
  } catch (error) {
    if (error instanceof ApiError) return error.message;
    throw error;
  }
}
