import js from "@eslint/js";
import globals from "globals";

export default [
  js.configs.recommended,
  {
    rules: { "no-unused-vars": ["error", { ignoreRestSiblings: true }] },
    linterOptions: { reportUnusedDisableDirectives: "error" },
    languageOptions: { globals: globals.browser },
  },
];
