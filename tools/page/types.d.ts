// Types of the page's scripts that their own comments do not contain.

/** The server's JSON, from `/openapi.json`; `make check` writes the file. */
type Answer<Name extends keyof import("./api").components["schemas"]> = import("./api").components["schemas"][Name];

/** The element that `el(tag)` makes: `button.primary` is a button. */
type Made<Tag extends string> = Tag extends `${infer Name}.${string}`
  ? Made<Name>
  : Tag extends keyof HTMLElementTagNameMap
    ? HTMLElementTagNameMap[Tag]
    : HTMLElement;

/** The elements of index.html. */
interface Document {
  getElementById(id: "ask" | "help" | "token"): HTMLDialogElement;
  getElementById(
    id: "announcer" | "banner" | "banner-countdown" | "banner-retry" | "banner-text" | "connection" | "help-button"
      | "theme-button" | "toasts" | "view-fly" | "view-title",
  ): HTMLElement;
}

/** Of the vendored Swagger UI. */
declare const SwaggerUIBundle: (options: object) => void;
