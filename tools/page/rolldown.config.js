// Bundles the page: one script and one style sheet for Fly, one script for each view that is loaded later.
import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";

const STATIC = new URL("../../drone_env/server/static/", import.meta.url);
const at = (name) => fileURLToPath(new URL(name, STATIC));

/** The style sheets in their order. Their relative URLs stay valid, because the folder is a sibling. */
const SHEETS = ["tokens", "base", "layout", "fly", "hello", "dialogs", "compare", "learn", "api_view", "editor"];
const styles = {
  name: "styles",
  generateBundle() {
    const source = SHEETS.map((name) => readFileSync(at(`css/${name}.css`), "utf8")).join("");
    this.emitFile({ type: "asset", fileName: "page.css", source });
  },
};

export default {
  input: at("js/main.js"),
  plugins: [styles],
  output: {
    dir: process.env.OUT,
    cleanDir: true,
    minify: true,
    entryFileNames: "[name].js",
    chunkFileNames: "[name].js",
    // The digest of the sources, by which a test sees an old bundle.
    postBanner: ({ isEntry }) => (isEntry ? `// ${process.env.SOURCES}` : ""),
    codeSplitting: { groups: [{ name: "fly", tags: ["$initial"] }] },
  },
};
