// Bundles the scripts of the page: one file for Fly, one for each view that is loaded later.
import { fileURLToPath } from "node:url";

const STATIC = new URL("../../drone_env/server/static/", import.meta.url);
const at = (name) => fileURLToPath(new URL(name, STATIC));

export default {
  input: at("js/main.js"),
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
