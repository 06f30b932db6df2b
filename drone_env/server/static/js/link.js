// Copies links.
import { toast } from "./dom.js";

/** Copies an address. */
export async function copyLink(url) {
  try {
    await navigator.clipboard.writeText(String(url));
    toast("Link copied.");
  } catch {
    // Without leave to write the clipboard, as in a frame of another site, the visitor copies it by hand.
    window.prompt("The link to this flight:", url);
  }
}
