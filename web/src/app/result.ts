/** What came out of a run: the surface in the viewer, its report, measures and files. */

import { decodeSurface, mountViewer, type ExportLink, type Theme, type ViewerHandle, type ViewerState } from "../viewer";
import { address, api, type AppState, type Run } from "./api";
import { button, el, fill } from "./dom";
import { Measure } from "./measure";
import type { Notices } from "./notice";
import { save } from "./save";
import { chooseTheme, currentTheme } from "./theme";
import { plural } from "./words";

const FORMAT_GROUPS: [string, string[]][] = [
  ["Heights", ["x3p", "sur", "sdf", "gwy", "gsf", "tif", "npz", "csv", "xyz", "vts"]],
  ["Meshes", ["stl", "ply", "obj", "glb", "off", "3mf", "print"]],
  ["Stereo pictures", ["anaglyph", "side-by-side"]],
];
const FORMAT_NAMES: Record<string, string> = {
  print: "STL for a 3D printer",
  anaglyph: "anaglyph (PNG)",
  "side-by-side": "side by side (PNG)",
};

/** What the viewer offers to save beside its own pictures and tables; those that always succeed. */
function links(run: Run, formats: string[], unit: string): ExportLink[] {
  const offered = unit === "um" ? ["x3p", "stl", "glb", "tif", "csv"] : ["glb", "tif", "csv"];
  return formats
    .filter((format) => offered.includes(format))
    .map((format) => ({ label: format.toUpperCase(), href: address(run.name, "export", format), download: "" }));
}

export class Result {
  readonly root = el("div", { class: "result" });
  private shown = "";
  private viewer: ViewerHandle | null = null;

  constructor(
    private readonly state: AppState,
    private readonly notices: Notices,
  ) {}

  update(run: Run): void {
    this.root.hidden = !run.has_result;
    const now = run.has_result ? `${run.name} ${run.revision}` : "";
    if (now === this.shown) return;
    this.shown = now;
    this.dispose();
    if (run.has_result) void this.show(run, now);
  }

  setTheme(): void {
    this.viewer?.setTheme(currentTheme());
  }

  dispose(): void {
    this.viewer?.dispose();
    this.viewer = null;
    fill(this.root);
  }

  private async show(run: Run, now: string): Promise<void> {
    const limits = el("div", {});
    const place = el("div", { class: "viewer-place" }, el("p", { class: "quiet" }, "Loading the surface …"));
    fill(
      this.root,
      limits,
      place,
      el("section", { class: "card", "aria-labelledby": "files-heading" }, el("h2", { id: "files-heading" }, "Report and files"), this.files(run)),
    );
    void api.result(run.name).then(({ warnings }) => {
      const told = Array.isArray(warnings) ? warnings.map(String) : [];
      if (told.length === 0) return;
      fill(limits, el("details", {}, el("summary", {}, `What limits this result: ${plural(told.length, "remark")}`),
        el("ul", { class: "warnings" }, ...told.map((text) => el("li", {}, text)))));
    }, () => undefined);
    const bytes = await this.notices.attempt(() => api.surface(run.name));
    if (this.shown !== now) return;
    if (bytes === undefined) {
      fill(place, el("p", { class: "banner bad" }, "The surface cannot be shown. Reconstruct again, or look into the report."));
      return;
    }
    place.addEventListener("semscape-theme", (event) => chooseTheme((event as CustomEvent<Theme>).detail));
    const surface = await this.notices.attempt(() => decodeSurface(bytes));
    if (this.shown !== now || surface === undefined) return;
    surface.name = run.title;
    this.root.append(new Measure(run.name, this.notices, surface, () => this.viewer?.state() ?? {}, run.revision).root);
    fill(place);
    const key = `viewer ${now}`;
    const kept = sessionStorage.getItem(key);
    this.viewer = mountViewer(place, surface, {
      label: `Surface of ${run.title}`,
      theme: currentTheme(),
      ...(kept === null ? {} : { state: JSON.parse(kept) as ViewerState }),
      exports: links(run, this.state.formats, surface.unit),
      onState: (state) => sessionStorage.setItem(key, JSON.stringify(state)),
    });
  }

  private files(run: Run): HTMLElement {
    const report = el("a", { href: address(run.name, "report"), target: "_blank", rel: "noopener", class: "button primary" }, "Open the report");
    const groups = FORMAT_GROUPS.map(([title, formats]) => {
      const known = formats.filter((format) => this.state.formats.includes(format));
      const offered = run.has_images ? known : known.filter((format) => format !== "anaglyph" && format !== "side-by-side");
      if (offered.length === 0) return null;
      return el("div", { class: "format-group" }, el("h3", {}, title),
        el("div", { class: "row" }, ...offered.map((format) => this.download(run, format))));
    });
    return el("div", {}, el("div", { class: "row" }, report), ...groups);
  }

  private download(run: Run, format: string): HTMLElement {
    const text = FORMAT_NAMES[format] ?? format.toUpperCase();
    return button(
      text,
      async () => {
        const file = await this.notices.attempt(() => api.exported(run.name, format));
        if (file) save(file.blob, file.filename);
      },
      { "data-format": format, "aria-label": `Save as ${text}` },
    );
  }
}
