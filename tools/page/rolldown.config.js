// Bundles the page: one script and one style sheet for Fly, one script for each view that is loaded later.
import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";

const STATIC = new URL("../../drone_env/server/static/", import.meta.url);
const at = (name) => fileURLToPath(new URL(name, STATIC));

/** The style sheets of index.html, in its order. Their relative URLs stay valid, because the folder is a sibling. */
const styles = {
  name: "styles",
  generateBundle() {
    const sheets = readFileSync(at("index.html"), "utf8").matchAll(/rel="stylesheet" href="static\/(.*?)"/g);
    const source = [...sheets].map(([, name]) => readFileSync(at(name), "utf8")).join("");
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
    // The server serves the bundle while this is the digest of the sources.
    postBanner: ({ isEntry }) => (isEntry ? `// ${process.env.SOURCES}` : ""),
    codeSplitting: { groups: [{ name: "fly", tags: ["$initial"] }] },
  },
};
