/** The panel beneath the views: what the tool has found. */

import { el, save } from "./dom";
import { unitSign } from "./numbers";
import { profilePlot } from "./plot";
import { nestingIndexOf, profileCsv, sigmaAt, valueText, type Choices, type Finding, type Tool } from "./tools";
import type { Place, Surface } from "./types";

export interface ResultsActions {
  choices(): Choices;
  choose(changes: Partial<Choices>): void;
  /** A place of the profile is pointed at in its plot. */
  point(place: Place | null): void;
}

/** Fill the panel anew. */
export function showResults(
  panel: HTMLElement, tool: Tool, surface: Surface, places: Place[], found: Finding | null, actions: ResultsActions,
): void {
  panel.replaceChildren();
  panel.hidden = !found;
  panel.dataset.tool = tool.name;
  if (!found) return;
  if (found.trouble) {
    panel.append(el("p", { class: "sv-trouble", role: "status" }, `No ${tool.title.toLowerCase()}: ${found.trouble}.`));
    return;
  }
  const rows = found.rows.map((row) =>
    el(
      "tr", { "data-name": row.name, "data-value": row.value },
      el("th", { scope: "row" }, row.name),
      el("td", { class: "sv-value" }, valueText(row)),
      el("td", { class: "sv-quiet" }, row.note ?? ""),
    ),
  );
  const table = el("table", { class: "sv-table" }, el("caption", {}, caption(tool, places)), el("tbody", {}, ...rows));
  const aside = el("div", { class: "sv-figures" }, table, ...controls(tool, surface, places, found, actions));
  if (found.profile) {
    const { profile } = found;
    const [from, to] = places;
    const along = (i: number): Place => {
      const share = i / Math.max(1, profile.distance.length - 1);
      return { x: from.x + share * (to.x - from.x), y: from.y + share * (to.y - from.y) };
    };
    const sigma = profile.distance.map((_, i) => sigmaAt(surface, along(i)));
    const plot = profilePlot(profile, sigma, unitSign(surface.unit), (i) => actions.point(i === null ? null : along(i)));
    panel.append(el("figure", { class: "sv-figure" }, plot));
  }
  panel.append(aside);
}

function caption(tool: Tool, places: Place[]): string {
  if (tool.name === "texture") {
    return `Height parameters of ${places.length ? "the region" : "the whole surface"}, a plane taken off`;
  }
  return tool.title;
}

function controls(tool: Tool, surface: Surface, places: Place[], found: Finding, actions: ResultsActions): HTMLElement[] {
  const sign = unitSign(surface.unit);
  if (tool.name === "profile" && found.profile) {
    const { profile } = found;
    const length = profile.distance[profile.distance.length - 1];
    const nesting = el("input", {
      type: "number", min: 0, step: "any", value: Number(nestingIndexOf(actions.choices(), length).toPrecision(6)),
    });
    nesting.addEventListener("change", () => actions.choose({ nestingIndex: Math.max(0, Number(nesting.value) || 0) }));
    const csv = el("button", { type: "button", class: "sv-button" }, "Save profile (CSV)");
    csv.addEventListener("click", () =>
      save(new Blob([profileCsv(surface, profile, places[0], places[1])], { type: "text/csv" }), "profile.csv"),
    );
    return [
      el("label", { class: "sv-field" }, `λc of Ra and Rq (${sign})`, nesting),
      el("p", { class: "sv-quiet" }, `Band: ±1 σ of the heights. Ra, Rq, Rt: roughness beyond λc; Pa, Pq, Pt: the profile without its line. ± is the height scale's 1 σ alone.`),
      csv,
    ];
  }
  if (tool.name === "region") {
    const select = el(
      "select", {},
      el("option", { value: "rim" }, "plane through the region's edge"),
      el("option", { value: "mean" }, "mean plane of the region"),
      el("option", { value: "lowest" }, "lowest height of the region"),
    );
    select.value = actions.choices().reference;
    select.addEventListener("change", () => actions.choose({ reference: select.value as Choices["reference"] }));
    return [el("label", { class: "sv-field" }, "Volumes from the", select), scaleNote()];
  }
  return tool.name === "step" || tool.name === "texture" ? [scaleNote()] : [];
}

function scaleNote(): HTMLElement {
  return el("p", { class: "sv-quiet" }, "± is the height scale's 1 σ alone; semscape measure states the whole uncertainty.");
}
