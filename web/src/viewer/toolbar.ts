/** The controls above the views: each a native one, so that keyboard and screen reader need no help. */

import { el, freshId, svg, type Child } from "./dom";
import type { Settings } from "./settings";
import type { ExportLink, Theme } from "./types";

export interface ToolbarActions {
  settings(): Settings;
  change(changes: Partial<Settings>): void;
  /** Bring the eye to where it sees all, from a direction of its own or from where it looks. */
  look(where: "home" | "top" | "here"): void;
  savePicture(): void;
  theme(): Theme;
  setTheme(theme: Theme): void;
}

const LEAST_LIFT = 0.25;
const MOST_LIFT = 20;

/** Return the bar, and a function that makes its controls say what the settings are. */
export function toolbar(
  actions: ToolbarActions,
  has: { micrograph: boolean; sigma: boolean; views: boolean; cameras: boolean; sparse: boolean; view3d: boolean },
  exports: ExportLink[],
): { bar: HTMLElement; refresh: () => void } {
  const refreshers: (() => void)[] = [];
  const { settings, change } = actions;

  const choice = <Key extends "colourBy" | "colourMap">(title: string, key: Key, items: [Settings[Key], string][]): HTMLElement => {
    const select = el("select", { "aria-label": title }, ...items.map(([value, text]) => el("option", { value }, text)));
    select.addEventListener("change", () => change({ [key]: select.value } as Partial<Settings>));
    refreshers.push(() => (select.value = settings()[key]));
    return select;
  };
  const choices = <Value extends string>(title: string, items: [Value, string][], get: () => Value, set: (value: Value) => void): HTMLElement => {
    const made = segments(title, items, get, set);
    refreshers.push(made.refresh);
    return made.group;
  };
  const toggle = (text: string, key: "shaded" | "anaglyph" | "cameras" | "sparse" | "axes", useful = true): HTMLElement => {
    const box = el("input", { type: "checkbox", disabled: !useful });
    box.addEventListener("change", () => {
      change({ [key]: box.checked });
      // The cameras stand above the surface: step back, so that they are seen.
      if (key === "cameras" && box.checked) actions.look("here");
    });
    refreshers.push(() => (box.checked = settings()[key]));
    return el("label", { class: "sv-check" }, box, text);
  };
  const slider = (
    title: string, least: number, most: number, step: number, get: () => number, set: (value: number) => void,
    tell: (value: number) => string,
  ): HTMLElement => {
    const id = freshId("range");
    const range = el("input", { type: "range", id, min: least, max: most, step });
    const told = el("output", { for: id });
    range.addEventListener("input", () => set(Number(range.value)));
    refreshers.push(() => {
      range.value = String(get());
      told.textContent = tell(get());
      range.setAttribute("aria-valuetext", tell(get()));
    });
    return el("label", { class: "sv-slider" }, el("span", {}, title), range, told);
  };

  const colours = el(
    "div", { class: "sv-group" },
    el("span", { class: "sv-name", "aria-hidden": "true" }, "Colour"),
    choice("Colour by", "colourBy", [
      ["height", "Height"],
      ...(has.micrograph ? ([["micrograph", "Micrograph"]] as [Settings["colourBy"], string][]) : []),
      ...(has.sigma ? ([["sigma", "Uncertainty"]] as [Settings["colourBy"], string][]) : []),
      ...(has.views ? ([["views", "Number of views"]] as [Settings["colourBy"], string][]) : []),
    ]),
    choice("Colour map", "colourMap", [["viridis", "viridis"], ["cividis", "cividis"]]),
  );
  const light = popover("Light", "M12 4v2m0 12v2M4 12h2m12 0h2M6.5 6.5L8 8m8 8l1.5 1.5m0-11L16 8m-8 8l-1.5 1.5M12 8.5a3.5 3.5 0 100 7 3.5 3.5 0 000-7",
    slider("Direction", 0, 360, 5, () => settings().lightAzimuthDeg, (value) => change({ lightAzimuthDeg: value }), (value) => `${value}°`),
    slider("Height", 5, 90, 1, () => settings().lightAltitudeDeg, (value) => change({ lightAltitudeDeg: value }), (value) => `${value}°`),
    toggle("Shade the surface", "shaded"),
    el("p", { class: "sv-quiet" }, "Direction clockwise from the top of the map; 315° is the upper left."),
  );
  const parts: Child[] = [colours];
  if (has.view3d) {
    parts.push(
      choices("Style of the surface", [["surface", "Surface"], ["wireframe", "Wireframe"], ["points", "Points"]], () => settings().style, (style) => change({ style })),
      choices("Projection", [["perspective", "Perspective"], ["orthographic", "Orthographic"]], () => settings().eye.projection, (projection) =>
        change({ eye: { ...settings().eye, projection } })),
      el("div", { class: "sv-group" }, slider(
        "z ×", Math.log2(LEAST_LIFT), Math.log2(MOST_LIFT), 0.01, () => Math.log2(settings().exaggeration),
        (value) => change({ exaggeration: rounded(2 ** value) }),
        (value) => `${rounded(2 ** value)}`,
      )),
      choices("Look from", [["home", "Tilted"], ["top", "Top"]], () => "" as "home" | "top", (where) => actions.look(where)),
    );
  }
  parts.push(light);
  if (has.view3d) {
    parts.push(popover("Show", "M2.5 12s3.5-6 9.5-6 9.5 6 9.5 6-3.5 6-9.5 6-9.5-6-9.5-6zM12 9.5a2.5 2.5 0 100 5 2.5 2.5 0 000-5",
      toggle("Axes", "axes"),
      toggle("Cameras of the series", "cameras", has.cameras),
      toggle("Sparse points", "sparse", has.sparse),
      toggle("Anaglyph for red-cyan glasses", "anaglyph"),
    ));
  }
  const picture = el("button", { type: "button", class: "sv-item" }, "Picture of the view (PNG)");
  picture.addEventListener("click", () => actions.savePicture());
  parts.push(popover("Save", "M12 4v11m-4-4l4 4 4-4M5 19h14", picture,
    ...exports.map((link) => el("a", { class: "sv-item", href: link.href, download: link.download ?? "" }, link.label)),
    exports.length ? null : el("p", { class: "sv-quiet" }, "Other formats: the run's folder, and semscape convert."),
  ));
  const themes: Theme[] = ["auto", "light", "dark"];
  const theme = el("button", { type: "button", class: "sv-button sv-only-icon" }, icon("M12 4a8 8 0 100 16zM12 4a8 8 0 010 16"));
  theme.addEventListener("click", () => {
    actions.setTheme(themes[(themes.indexOf(actions.theme()) + 1) % 3]);
    refresh();
  });
  refreshers.push(() => {
    const name = { auto: "as the system", light: "light", dark: "dark" }[actions.theme()];
    theme.title = `Light or dark: ${name}`;
    theme.setAttribute("aria-label", `Light or dark: ${name}; press to change`);
  });
  parts.push(theme);
  const refresh = (): void => {
    for (const tell of refreshers) tell();
  };
  refresh();
  return { bar: el("div", { class: "sv-bar", role: "group", "aria-label": "View" }, ...parts), refresh };
}

/** Return buttons of which one is pressed, and a function that makes them say which. */
export function segments<Value extends string>(
  title: string, items: [Value, string][], get: () => Value, set: (value: Value) => void,
): { group: HTMLElement; refresh: () => void } {
  const buttons = items.map(([value, text]) => {
    const button = el("button", { type: "button" }, text);
    button.addEventListener("click", () => set(value));
    return button;
  });
  return {
    group: el("div", { class: "sv-segments", role: "group", "aria-label": title }, ...buttons),
    refresh: () => items.forEach(([value], i) => buttons[i].setAttribute("aria-pressed", String(get() === value))),
  };
}

function rounded(value: number): number {
  const digits = value >= 10 ? 0 : value >= 2 ? 1 : 2;
  const near = Number(value.toFixed(digits));
  // The true proportions are easily met.
  return Math.abs(value - 1) < 0.04 ? 1 : near;
}

/** Return a button that opens a small panel; Escape and a click elsewhere close it. */
function popover(title: string, path: string, ...content: Child[]): HTMLElement {
  const summary = el("summary", { class: "sv-button" }, icon(path), title);
  const details = el("details", { class: "sv-popover" }, summary, el("div", { class: "sv-panel" }, ...content));
  details.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || !details.open) return;
    details.open = false;
    summary.focus();
    event.stopPropagation();
  });
  details.addEventListener("focusout", (event) => {
    if (event.relatedTarget && !details.contains(event.relatedTarget as Node)) details.open = false;
  });
  const elsewhere = (event: Event): void => {
    if (!details.contains(event.target as Node)) details.open = false;
    if (!details.isConnected) document.removeEventListener("pointerdown", elsewhere);
  };
  document.addEventListener("pointerdown", elsewhere);
  return details;
}

/** Return a line drawing of 24 px, for decoration only. */
export function icon(path: string): SVGElement {
  return svg("svg", { viewBox: "0 0 24 24", class: "sv-icon", "aria-hidden": "true" }, svg("path", { d: path }));
}
