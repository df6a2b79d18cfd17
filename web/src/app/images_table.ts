/** The table of what was understood of the images. A cell that is edited goes into series.toml at once. */

import { address, api, type Cell, type Row, type Run, type SeriesTable } from "./api";
import { button, el, fill } from "./dom";
import type { Live } from "./live";
import type { Notices } from "./notice";
import { unique } from "./upload";
import { isNumber, number, unitText } from "./words";

interface Column {
  key: string;
  title: string;
  hint: string;
}

const OF_IMAGES: Column[] = [
  { key: "pixel_size_um", title: "Pixel size (µm)", hint: "pixel size in µm" },
  { key: "tilt_deg", title: "Tilt (°)", hint: "tilt in degrees" },
  { key: "data_bar_rows", title: "Data bar (rows)", hint: "height of the data bar in rows" },
];
const OF_SERIES: Column[] = [
  { key: "pixel_size_um", title: "Pixel size of all (µm)", hint: "from the files where empty" },
  { key: "axis_deg", title: "Tilt axis (°)", hint: "0 horizontal, 90 vertical; found from the images where empty" },
  { key: "scale_bar_um", title: "Scale bar length (µm)", hint: "what the bar in the images stands for" },
];

export class ImagesTable {
  readonly root = el("div", { class: "images" });
  private table: SeriesTable | null = null;
  private name = "";
  private isBusy = false;
  private asked = 0;
  private seen = "";
  private readonly undoButton = button("Undo", () => this.change(() => api.undo(this.name)), { "data-cell": "undo" });
  private readonly redoButton = button("Redo", () => this.change(() => api.redo(this.name)), { "data-cell": "redo" });

  constructor(
    private readonly live: Live,
    private readonly notices: Notices,
  ) {
    this.root.addEventListener("keydown", (event) => this.key(event));
  }

  /** Show a run's images; read again what another tab, or the disk, has changed. */
  async update(run: Run): Promise<void> {
    const isBusy = run.state === "queued" || run.state === "running";
    const now = `${run.name} ${run.n_images} ${run.state}`;
    if (now === this.seen) return;
    const isOther = this.name !== run.name;
    this.seen = now;
    this.name = run.name;
    this.isBusy = isBusy;
    if (isOther) fill(this.root, el("p", { class: "quiet" }, "Reading the images …"));
    await this.load();
  }

  async load(): Promise<void> {
    await this.change(() => api.series(this.name));
  }

  private async change(work: () => Promise<SeriesTable>): Promise<void> {
    const mine = ++this.asked;
    this.root.setAttribute("aria-busy", "true");
    const table = await this.notices.attempt(work);
    if (mine !== this.asked) return;
    this.root.removeAttribute("aria-busy");
    if (table !== undefined) this.table = table;
    this.draw();
  }

  private draw(): void {
    const table = this.table;
    if (table === null) return;
    const focused = document.activeElement?.getAttribute("data-cell");
    this.undoButton.disabled = this.isBusy || !table.can_undo;
    this.redoButton.disabled = this.isBusy || !table.can_redo;
    const size = table.width ? `${table.rows.length} images of ${table.width} × ${table.height} px` : "";
    const head = ["", "Image", "Vendor", ...OF_IMAGES.map((column) => column.title), "Warnings", ""];
    const rows = table.rows.map((row) => this.row(row));
    fill(
      this.root,
      table.problem ? el("p", { class: "banner bad", role: "alert" }, table.problem) : null,
      el("div", { class: "row" }, el("p", { class: "quiet grow" }, size), this.undoButton, this.redoButton),
      el(
        "div",
        { class: "scroll", tabindex: 0, role: "region", "aria-label": "Images" },
        el(
          "table",
          {},
          el("thead", {}, el("tr", {}, ...head.map((title) => el(title ? "th" : "td", title ? { scope: "col" } : {}, title)))),
          el("tbody", {}, ...rows),
        ),
      ),
      el("div", { class: "fields" }, ...OF_SERIES.map((column) => this.seriesField(column, table))),
      table.warnings.length
        ? el("div", { class: "warnings" }, el("h3", {}, "Warnings"), el("ul", {}, ...table.warnings.map((text) => el("li", {}, text))))
        : null,
      el("p", { class: "quiet" }, "Empty a cell to take the file's value again. Edits stand in series.toml beside the images; ",
        "Enter goes to the next image."),
    );
    if (focused) this.root.querySelector<HTMLElement>(`[data-cell="${CSS.escape(focused)}"]`)?.focus();
  }

  private row(row: Row): HTMLElement {
    const warnings = Array.isArray(row.understood.warnings) ? row.understood.warnings.length : 0;
    const picture = el("img", { src: address(this.name, "images", row.image), alt: "", loading: "lazy", class: "small" });
    picture.addEventListener("error", () => picture.classList.add("absent"));
    const vendor = typeof row.understood.vendor === "string" ? row.understood.vendor : "";
    return el(
      "tr",
      {},
      el("td", {}, picture),
      el("th", { scope: "row" }, row.original),
      el("td", {}, vendor || "–"),
      ...OF_IMAGES.map((column) => el("td", {}, ...this.cell(row, column))),
      el("td", {}, warnings ? el("span", { class: "chip warn" }, String(warnings)) : "–"),
      el(
        "td",
        {},
        button("Remove", () => this.remove(row), {
          class: "plain",
          disabled: this.isBusy,
          "aria-label": `Remove ${row.original}`,
        }),
      ),
    );
  }

  private cell(row: Row, column: Column): (Node | null)[] {
    const told = row.told[column.key];
    const understood = row.understood[column.key];
    const sources = (row.understood.sources ?? {}) as Record<string, string>;
    const source = told !== undefined ? "edited" : isNumber(understood) ? (sources[column.key] ?? "") : "unknown";
    const shown = told ?? understood;
    const input = el("input", {
      type: "text",
      inputmode: "decimal",
      class: told !== undefined ? "told" : "",
      value: isNumber(shown) ? number(shown, 6) : "",
      "aria-label": `${row.original}: ${column.hint}`,
      "data-cell": `${row.image}|${column.key}`,
      disabled: this.isBusy,
      autocomplete: "off",
      size: 9,
    });
    this.edits(input, row.image, column.key, told !== undefined);
    return [input, el("span", { class: "source" }, sourceText(source))];
  }

  private seriesField(column: Column, table: SeriesTable): HTMLElement {
    const told = table.told[column.key];
    const id = unique();
    const input = el("input", {
      id,
      type: "text",
      inputmode: "decimal",
      value: isNumber(told) ? number(told, 6) : "",
      "aria-describedby": `${id}-hint`,
      "data-cell": `|${column.key}`,
      disabled: this.isBusy,
      autocomplete: "off",
      size: 9,
    });
    this.edits(input, "", column.key, told !== undefined);
    return el("div", { class: "field" }, el("label", { for: id }, column.title), input,
      el("span", { class: "quiet", id: `${id}-hint` }, column.hint));
  }

  private edits(input: HTMLInputElement, image: string, key: string, isTold: boolean): void {
    const before = input.value;
    input.addEventListener("change", () => {
      const text = input.value.trim().replace(/^\+/, "").replace(",", ".").replace("−", "-");
      if (text === before || (text === "" && !isTold)) {
        input.value = before;
        return;
      }
      const value: Cell = text === "" ? null : Number(text);
      if (value !== null && !Number.isFinite(value)) {
        input.setAttribute("aria-invalid", "true");
        this.notices.say(`“${input.value}” is not a number. Write it like 0.05 or -3.5, or empty the cell.`, "bad");
        return;
      }
      void this.change(() => api.edit(this.name, image, key, value)).then(() => this.live.refresh());
    });
  }

  private async remove(row: Row): Promise<void> {
    if ((await this.notices.attempt(() => api.removeImage(this.name, row.image))) !== undefined) await this.load();
  }

  private key(event: KeyboardEvent): void {
    const input = event.target;
    if (!(input instanceof HTMLInputElement)) return;
    if (event.key === "Escape") {
      input.value = input.defaultValue;
    } else if (event.key === "Enter") {
      const key = input.dataset.cell?.split("|")[1] ?? "";
      const column = [...this.root.querySelectorAll<HTMLInputElement>(`tbody input[data-cell$="|${CSS.escape(key)}"]`)];
      const next = column[column.indexOf(input) + 1];
      if (next) next.focus();
      else input.blur();
    } else if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z" && input.value === input.defaultValue) {
      event.preventDefault(); // within a cell that is being typed in, the browser's own undo goes first
      void this.change(() => (event.shiftKey ? api.redo(this.name) : api.undo(this.name)));
    }
  }
}

function sourceText(source: string): string {
  return { file: "from the file", sidecar: "edited", image: "seen in the image", user: "edited" }[source] ?? unitText(source);
}
