/** ISO 25178 parameters of the whole surface or a region, and steps between regions, as semscape.metrology has them. */

import { closedRings, NO_MARKS, type Marks, type Surface, type ViewerState } from "../viewer";
import { api, type Figure, type Measurement } from "./api";
import { button, el, fill } from "./dom";
import { keepFields, keepValue, keptValue } from "./kept";
import type { Notices } from "./notice";
import { save } from "./save";
import { unique } from "./upload";
import { unitText, withSigma } from "./words";

const FORMS: [string, string][] = [
  ["plane", "plane"],
  ["poly2", "polynomial of degree 2"],
  ["poly3", "polynomial of degree 3"],
  ["poly4", "polynomial of degree 4"],
  ["sphere", "sphere"],
  ["none", "nothing"],
];

const A_REGION = "A region is two opposite corners in px, like 100, 200, 300, 400, or all corners of a polygon.";

export class Measure {
  readonly root: HTMLElement;
  private readonly level = el("select", { id: unique() }, ...FORMS.map(([value, text]) => el("option", { value }, text)));
  private readonly robust = el("input", { type: "checkbox", id: unique() });
  private readonly sFilter = textField();
  private readonly lFilter = textField();
  private readonly region = textField(20);
  private readonly profile = textField(20);
  private readonly first = textField(20);
  private readonly second = textField(20);
  private readonly answer = el("div", { "aria-live": "polite" });
  private readonly stride: number;
  private readonly keep: () => void;
  private last: Measurement | null;

  constructor(
    private readonly name: string,
    private readonly notices: Notices,
    surface: Surface,
    private readonly drawn: () => ViewerState,
    private readonly revision: string,
  ) {
    this.stride = surface.stride;
    const length = unitText(surface.unit);
    const form = el(
      "form",
      { class: "fields" },
      labelled("Level by taking off", this.level),
      labelled("S-filter", this.sFilter, `${length}; shorter waves go`),
      labelled("L-filter", this.lFilter, `${length}; longer waves go`),
      labelled("Region", this.region, "x0, y0, x1, y1 in px, or all corners of a polygon; the whole where empty"),
      labelled("Profile from, to", this.profile, "x0, y0, x1, y1 in px"),
      labelled("Step from region", this.first, "x0, y0, x1, y1 in px, or all corners"),
      labelled("Step to region", this.second, "x0, y0, x1, y1 in px, or all corners"),
      el("div", { class: "field check" }, this.robust, el("label", { for: this.robust.id }, "Level on the majority of the heights")),
    );
    const press = button("Measure", () => this.ask(), { class: "primary", type: "submit" });
    form.addEventListener("submit", (event) => event.preventDefault());
    form.append(el("div", { class: "row" }, press, button("Take the places marked in the viewer", () => this.takePlaces())));
    this.root = el(
      "section",
      { class: "card", "aria-labelledby": "measure-heading" },
      el("h2", { id: "measure-heading" }, "Surface parameters (ISO 25178) and steps"),
      form,
      this.answer,
    );
    const fields = [this.level, this.robust, this.sFilter, this.lFilter, this.region, this.profile, this.first, this.second];
    this.keep = keepFields(`measure ${this.name}`, fields);
    this.last = keptValue<Measurement>(this.keyOfAnswer());
    if (this.last) this.show(this.last);
  }

  private keyOfAnswer(): string {
    return `measured ${this.name} ${this.revision}`;
  }

  /** Fill the fields with what is marked in the viewer: its regions and lines are those of its tool. */
  private takePlaces(): void {
    const { tool, marks } = this.drawn() as { tool?: string; marks?: Marks };
    const regions = closedRings(marks ?? NO_MARKS).map((ring) => this.text(ring));
    if (tool === "step" && regions.length === 2) {
      this.first.value = regions[0]!;
      this.second.value = regions[1]!;
    } else if (tool === "profile" && marks?.places.length === 2) {
      this.profile.value = this.text(marks.places);
    } else if ((tool === "region" || tool === "texture") && regions.length === 1) {
      this.region.value = regions[0]!;
    } else {
      return this.notices.say("Nothing is marked yet: mark a profile, a step's two regions, or a region with the viewer's tools.");
    }
    this.keep();
  }

  /** Places of the viewer, in px of the run's map. */
  private text(places: Marks["places"]): string {
    return places.flatMap(({ x, y }) => [x * this.stride, y * this.stride].map(Math.round)).join(", ");
  }

  private async ask(): Promise<void> {
    const question = this.question();
    if (question === null) return;
    fill(this.answer, el("p", { class: "quiet" }, "Measuring; the uncertainties take some seconds …"));
    const found = await this.notices.attempt(() => api.measure(this.name, question));
    fill(this.answer);
    if (found === undefined) return;
    this.last = found;
    keepValue(this.keyOfAnswer(), found);
    this.show(found);
  }

  private question(): Record<string, unknown> | null {
    const question: Record<string, unknown> = { level: this.level.value, robust: this.robust.checked };
    for (const [key, input] of [["s_filter_um", this.sFilter], ["l_filter_um", this.lFilter]] as const) {
      if (!input.value.trim()) continue;
      const value = Number(input.value.replace(",", "."));
      if (!(value > 0)) return this.refuse(input, "A filter is a positive length, like 2.5.");
      question[key] = value;
    }
    const profile = numbers(this.profile.value);
    if (profile === null || profile.length > 4) {
      return this.refuse(this.profile, "A profile is four numbers in px, like 100, 200, 300, 400.");
    }
    if (profile.length) question.profile = profile;
    const region = numbers(this.region.value);
    if (region === null) return this.refuse(this.region, A_REGION);
    if (region.length) question.region = region;
    const [first, second] = [numbers(this.first.value), numbers(this.second.value)];
    if (first === null || second === null || !first.length !== !second.length) {
      return this.refuse(first ? this.second : this.first, `A step needs two regions. ${A_REGION}`);
    }
    if (first.length) question.step = [first, second];
    return question;
  }

  private refuse(input: HTMLInputElement, words: string): null {
    this.notices.say(words, "bad");
    input.focus();
    return null;
  }

  private show(found: Measurement): void {
    const groups = new Map<string, Figure[]>();
    for (const figure of found.figures) groups.set(figure.group, [...(groups.get(figure.group) ?? []), figure]);
    const asked = (group: string): number => (/^(step|profile|angle|distance)/.test(group) ? 0 : 1);
    const ordered = [...groups].sort(([a], [b]) => asked(a) - asked(b));
    const bodies = ordered.map(([group, figures]) =>
      el(
        "tbody",
        { "data-group": group },
        el("tr", {}, el("th", { colspan: 5, scope: "rowgroup", class: "group" }, group)),
        ...figures.map((figure) => {
          const [value, sigma] = withSigma(figure.value, figure.sigma);
          return el("tr", { "data-figure": figure.name }, el("th", { scope: "row" }, figure.name), el("td", { class: "num" }, value),
            el("td", { class: "num" }, sigma && `± ${sigma}`), el("td", {}, unitText(figure.unit)), el("td", { class: "quiet" }, figure.meaning));
        }),
      ),
    );
    fill(
      this.answer,
      el("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Parameters" },
        el("table", { class: "figures" },
          el("thead", {}, el("tr", {}, ...["Parameter", "Value", "1 sigma", "Unit", "Meaning"].map((title) => el("th", { scope: "col" }, title)))),
          ...bodies)),
      found.warnings.length ? el("ul", { class: "warnings" }, ...found.warnings.map((text) => el("li", {}, text))) : null,
      el("div", { class: "row" }, button("Save as CSV", () => this.saveTable())),
    );
  }

  private saveTable(): void {
    const rows = (this.last?.figures ?? []).map((figure) =>
      [figure.group, figure.name, figure.value ?? "", figure.sigma ?? "", figure.unit, figure.meaning]
        .map((item) => (/[",\n]/.test(String(item)) ? `"${String(item).replaceAll('"', '""')}"` : String(item)))
        .join(","),
    );
    save(new Blob([["group,name,value,sigma,unit,meaning", ...rows].join("\n") + "\n"], { type: "text/csv" }), `${this.name}-measurement.csv`);
  }
}

function textField(size = 8): HTMLInputElement {
  return el("input", { type: "text", id: unique(), size, autocomplete: "off", inputmode: size > 8 ? null : "decimal" });
}

function labelled(title: string, field: HTMLElement, hint = ""): HTMLElement {
  if (hint) field.setAttribute("aria-describedby", `${field.id}-hint`);
  return el("div", { class: "field" }, el("label", { for: field.id }, title), field,
    hint ? el("span", { class: "quiet", id: `${field.id}-hint` }, hint) : null);
}

/** Four numbers of a text, or three pairs and more; none of an empty one, null of another. */
function numbers(text: string): number[] | null {
  if (!text.trim()) return [];
  const found = text.split(/[,;\s]+/).filter(Boolean).map(Number);
  const isPlace = found.length === 4 || (found.length >= 6 && found.length % 2 === 0);
  return isPlace && found.every(Number.isFinite) ? found : null;
}

