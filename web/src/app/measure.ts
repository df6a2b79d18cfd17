/** ISO 25178 parameters of the whole surface or a region, and steps between regions, as semscape.metrology has them. */

import type { Surface, ViewerState } from "../viewer";
import { api, type Figure, type Measurement } from "./api";
import { button, el, fill } from "./dom";
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
  private last: Measurement | null = null;

  constructor(
    private readonly name: string,
    private readonly notices: Notices,
    surface: Surface,
    private readonly drawn: () => ViewerState,
  ) {
    this.stride = surface.stride;
    const length = unitText(surface.unit);
    const form = el(
      "form",
      { class: "fields" },
      labelled("Level by taking off", this.level),
      labelled("S-filter", this.sFilter, `${length}; shorter waves go`),
      labelled("L-filter", this.lFilter, `${length}; longer waves go`),
      labelled("Region", this.region, "x0, y0, x1, y1 in px; all where empty"),
      labelled("Profile from, to", this.profile, "x0, y0, x1, y1 in px"),
      labelled("Step from region", this.first, "x0, y0, x1, y1 in px"),
      labelled("Step to region", this.second, "x0, y0, x1, y1 in px"),
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
  }

  /** Fill the fields with what is marked in the viewer: its regions and lines are those of its tool. */
  private takePlaces(): void {
    const { tool, places } = this.drawn() as { tool?: string; places?: { x: number; y: number }[] };
    const marked = (places ?? []).map(({ x, y }) => [x * this.stride, y * this.stride].map(Math.round).join(", "));
    const line = (start: number): string => `${marked[start]}, ${marked[start + 1]}`;
    if (tool === "step" && marked.length === 4) {
      this.first.value = line(0);
      this.second.value = line(2);
    } else if (tool === "profile" && marked.length === 2) {
      this.profile.value = line(0);
    } else if ((tool === "region" || tool === "texture") && marked.length === 2) {
      this.region.value = line(0);
    } else {
      this.notices.say("Nothing is marked yet: mark a profile, a step's two regions, or a region with the viewer's tools.");
    }
  }

  private async ask(): Promise<void> {
    const question = this.question();
    if (question === null) return;
    fill(this.answer, el("p", { class: "quiet" }, "Measuring; the uncertainties take some seconds …"));
    const found = await this.notices.attempt(() => api.measure(this.name, question));
    fill(this.answer);
    if (found === undefined) return;
    this.last = found;
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
    for (const [key, input] of [["region", this.region], ["profile", this.profile]] as const) {
      const place = numbers(input.value);
      if (place === null) return this.refuse(input, "A place is four numbers in px, like 100, 200, 300, 400.");
      if (place.length) question[key] = place;
    }
    const [first, second] = [numbers(this.first.value), numbers(this.second.value)];
    if (first === null || second === null || first.length !== second.length) {
      return this.refuse(this.first, "A step needs two regions of four numbers each, like 100, 200, 300, 400.");
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

/** Four numbers of a text; none of an empty one, null of another. */
function numbers(text: string): number[] | null {
  if (!text.trim()) return [];
  const found = text.split(/[,;\s]+/).filter(Boolean).map(Number);
  return found.length === 4 && found.every(Number.isFinite) ? found : null;
}

