// Types of the page's scripts that their own comments do not contain.

/** The server's JSON, from `/openapi.json`; `make check` writes the file. */
type Answer<Name extends keyof import("./api").components["schemas"]> = import("./api").components["schemas"][Name];

/** The element that `el(tag)` makes: `button.primary` is a button. */
type Made<Tag extends string> = Tag extends `${infer Name}.${string}`
  ? Made<Name>
  : Tag extends keyof HTMLElementTagNameMap
    ? HTMLElementTagNameMap[Tag]
    : HTMLElement;

/** What scripts look for by class or id is HTML. */
interface ParentNode {
  querySelector<Name extends keyof HTMLElementTagNameMap>(selector: Name): HTMLElementTagNameMap[Name] | null;
  querySelector(selector: string): HTMLElement | null;
  querySelectorAll<Name extends keyof HTMLElementTagNameMap>(selector: Name): NodeListOf<HTMLElementTagNameMap[Name]>;
  querySelectorAll<Found extends HTMLElement = HTMLElement>(selector: string): NodeListOf<Found>;
}

/** The elements of index.html. */
interface Document {
  getElementById(id: "ask" | "help" | "token"): HTMLDialogElement;
  getElementById(
    id: "api" | "calls" | "compare" | "draw" | "fly" | "learn" | "lessons" | "plan" | "race",
  ): HTMLTemplateElement;
  getElementById(
    id: "about" | "announcer" | "banner" | "banner-retry" | "banner-text" | "connection" | "help-button" | "map-credit"
      | "own-days" | "scoring" | "theme-button" | "toasts" | "today" | "view-fly" | "view-title",
  ): HTMLElement;
}

/** Of the vendored Swagger UI. */
declare const SwaggerUIBundle: (options: object) => void;

type Drawing = import("../../drone_env/server/static/js/drawing.js").Drawing;
type Emitter = import("../../drone_env/server/static/js/base.js").Emitter;
type Race = import("../../drone_env/server/static/js/race.js").Race;
type Stage = import("../../drone_env/server/static/js/stage.js").Stage;
type Track = import("../../drone_env/server/static/js/track.js").Track;
/** Who flew a flight, and with what help; missing fields are false or null. */
type Provenance = Partial<Answer<"Parent-Output">> & { pilot: string };

/** The shared state of the page. Events, sent after a change: "view" (name), "theme" (name), "layers", "camera", "task" (new task). */
interface Context extends Emitter {
  /** The address of the page. */
  router: import("../../drone_env/server/static/js/router.js").Router;
  /** HTTP calls. */
  api: ReturnType<typeof import("../../drone_env/server/static/js/api.js").createApi>;
  /** Whether the server answers, and its news. */
  server: import("../../drone_env/server/static/js/server.js").Server;
  tasks: Answer<"TaskInfo">[];
  /** A task by its short name, id or grader. */
  task(name: string | null): Answer<"TaskInfo"> | undefined;
  /** The tasks by family. */
  families: Map<string, Answer<"TaskInfo">[]>;
  pilots: Answer<"PilotInfo">[];
  /** A pilot by its id, or what stands for another agent. */
  pilot(id: string): Omit<Answer<"PilotInfo">, "colour"> & { colour: string };
  /** The maximum number of pilots of a flight. */
  most: number;
  kinds: Answer<"KindInfo">[];
  /** The names of the kinds of cells, by id. */
  names: Record<number, string>;
  /** The map, the flights and the moment of Fly. */
  stage: Stage;
  camera: import("../../drone_env/server/static/js/camera.js").Camera;
  view: string;
  /** Whether a layer is shown. */
  shows(id: string): boolean;
  showLayer(id: string, shown: boolean): void;
  /** Loads the task of a drawn map, which `/tasks` does not list. */
  meet(name: string | null): Promise<void>;
}

/** The state of the page. Missing parts are null or an empty list. */
interface Address {
  view: string;
  /** Short name, id or grader. */
  task: string | null;
  /** The server rejects anything but a map number. */
  seed: number | string | null;
  profile: string | null;
  /** Also the compared pilots in Compare. */
  pilots: string[];
  /** A stored flight. */
  episode: string | null;
  /** A file that this tab has opened: flights in Fly, of which `selected` is shown, or a map in Draw. */
  file: string | null;
  /** A stored flight to fly against. */
  ghost: string | null;
  /** The moment; by default the start of a stored flight and the newest step of a live one. */
  step: number | null;
  /** The step at which the last pilot leaves the flight of `of`. */
  fork: number | null;
  /** All actions of the fork, or of the visitor's flight: one letter each. */
  actions: string | null;
  /** The pilot before the fork; without a fork, the visitor as the record names him. */
  of: string | null;
  /** The selected flight, from 1; by default the visitor's, or else the first. */
  selected: number | null;
  /** The steps that the pilots have flown, if neither the moves nor the step say it. */
  ended: number | null;
  /** From 1. */
  lesson: number | null;
  /** Parts with invalid values. */
  unread: string[];
}

/** The map: the head of its flights, with its task. */
type World = Omit<Answer<"FlightHeader">, "task"> & { task: Answer<"TaskInfo"> } & Pick<Answer<"TaskInfo">, "width" | "height" | "max_steps" | "battery_capacity">;

/** The position of the grid in the window, in device pixels. */
interface Layout {
  /** Side of a cell, whole. */
  cell: number;
  /** Corner of cell [0, 0]. */
  left: number;
  top: number;
  /** Device pixels per CSS pixel. */
  scale: number;
  /** Whether the numbers of columns and rows fit. */
  labels: boolean;
}

interface Layer {
  id: string;
  /** "air" is drawn in every animation frame, the others on change. */
  place: "ground" | "cells" | "air";
  /** The label of its switch; a layer without a name is always shown. */
  name?: string;
  key?: string;
  hint?: string;
  /** Whether it is shown until the visitor chooses. */
  on?(context: Context): boolean;
  /** Whether it needs `POST /values`. */
  needsValues?: boolean;
  /** Whether it has something to show. */
  when?(stage: Stage): boolean;
  draw(ctx: CanvasRenderingContext2D, view: any): void;
}

/** What a start flies. */
interface Start {
  setup: Partial<Address>;
  /** Flights to show beside them: finished ones, and in a fork those of its pilots. */
  beside: Track[];
  /** The visitor's first changes: moves, `UNDO` and `VALUES`. */
  moves: string[];
}

