/** One run: its images, its progress, its result. */

import { address, api, type AppState, type Run } from "./api";
import { button, el, fill } from "./dom";
import { ImagesTable } from "./images_table";
import { keepFields } from "./kept";
import type { Live } from "./live";
import type { Notices } from "./notice";
import { Progress } from "./progress";
import { Result } from "./result";
import { chipClass, chipText } from "./runs_page";
import { DropZone, unique } from "./upload";

const MIRROR = "sfm.invert_relief=true";

export class RunPage {
  readonly root = el("div", { class: "page" });
  title = "Run";
  private readonly body = el("div", {});
  private readonly missing = el("div", {});
  private readonly head = el("div", { class: "head" });
  private readonly actions = el("div", { class: "row actions" });
  private readonly settings = el("textarea", { id: unique(), rows: 3, spellcheck: "false" });
  private readonly mirror = el("input", { type: "checkbox", id: unique() });
  private readonly images = el("details", { class: "card" });
  private readonly table: ImagesTable;
  private readonly progress = new Progress();
  private readonly result: Result;
  private readonly stop: () => void;
  private shown = "";
  private wasOpened = false;

  constructor(
    private readonly name: string,
    private readonly live: Live,
    private readonly notices: Notices,
    state: AppState,
  ) {
    this.table = new ImagesTable(live, notices);
    this.result = new Result(state, notices);
    const drop = new DropZone(
      state,
      notices,
      "Add images, or a series.toml.",
      () => Promise.resolve(this.name),
      () => void live.refresh().then(() => this.table.load()),
    );
    drop.accept(this.root);
    this.images.append(
      el("summary", {}, el("h2", {}, "Images")),
      this.table.root,
      drop.root,
      el("details", {}, el("summary", {}, "More settings"),
        el("div", { class: "field" }, el("label", { for: this.settings.id }, "Options, one a line, like dense.max_pairs=4"),
          this.settings)),
    );
    this.body.append(this.head, this.actions, this.progress.root, this.result.root, this.images);
    this.root.append(el("a", { href: "#/", class: "back" }, "← All runs"), this.missing, this.body);
    this.images.addEventListener("toggle", () => this.opened());
    this.stop = live.listen(() => this.update());
  }

  leave(): void {
    this.stop();
    this.result.dispose();
  }

  setTheme(): void {
    this.result.setTheme();
  }

  private update(): void {
    const run = this.live.find(this.name);
    if (run === undefined) {
      if (this.live.trouble) return;
      this.body.hidden = true;
      fill(this.missing, el("h1", {}, "No such run"),
        el("p", {}, "It may have been removed, or its address was cut. Go back to the list."));
      return;
    }
    this.body.hidden = false;
    fill(this.missing);
    this.title = run.title;
    const isFirst = this.shown === "";
    const now = JSON.stringify({ ...run, stages: [] });
    if (now !== this.shown) {
      this.shown = now;
      this.drawHead(run);
      this.drawActions(run);
    }
    this.progress.update(run);
    this.result.update(run);
    this.images.hidden = !run.has_images;
    if (!run.has_images) return;
    if (isFirst) {
      this.images.open = !run.has_result;
      this.mirror.checked = run.settings.includes(MIRROR);
      this.settings.value = run.settings.filter((setting) => setting !== MIRROR).join("\n");
      keepFields(`settings ${run.name} ${run.settings.join(" ")}`, [this.mirror, this.settings]);
    }
    if (this.images.open || this.wasOpened) void this.table.update(run);
  }

  private opened(): void {
    const run = this.live.find(this.name);
    this.wasOpened ||= this.images.open;
    if (run && this.images.open) void this.table.update(run);
  }

  private drawHead(run: Run): void {
    document.title = `${run.title} – semscape`;
    fill(
      this.head,
      el("h1", {}, run.title, " ", el("span", { class: `chip ${chipClass(run)}` }, chipText(run))),
      run.verdict ? el("p", { class: `banner ${gradeClass(run)}` }, run.verdict) : null,
      run.message ? el("p", { class: `banner ${run.state === "failed" ? "bad" : "plain"}`, role: "status" }, run.message) : null,
      run.state === "failed" && run.stages.length > 0
        ? el("p", {}, el("a", { href: address(run.name, "log"), target: "_blank", rel: "noopener" }, "Log of this run"))
        : null,
      run.is_stale && run.state !== "running" && run.state !== "queued"
        ? el("p", { class: "banner warn" }, "The images, or what is told of them, have changed since this result. Reconstruct again to use that.")
        : null,
    );
  }

  private drawActions(run: Run): void {
    const had = this.actions.contains(document.activeElement);
    if (run.state === "running" || run.state === "queued") {
      fill(this.actions, button("Cancel", async () => void (await this.do(() => api.cancel(run.name)))),
        el("p", { class: "quiet" }, "You may close this page: the run goes on while semscape app does."));
    } else if (run.has_images) {
      const text = run.has_result ? "Reconstruct again" : run.state === "cancelled" ? "Go on" : "Reconstruct";
      fill(
        this.actions,
        button(text, async () => void (await this.do(() => api.reconstruct(run.name, this.chosen()))), {
          class: run.has_result ? "" : "primary",
          "data-action": "reconstruct",
          disabled: run.n_images < 2,
        }),
        run.has_result && (run.sign_is_assumed || this.mirror.checked)
          ? el("span", { class: "check" }, this.mirror, el("label", { for: this.mirror.id }, "Mirror the relief (hills look like pits)"))
          : null,
      );
    } else {
      fill(this.actions);
    }
    if (run.has_images) this.actions.append(button("Rename", () => this.rename(run), { class: "plain" }));
    if (had) this.actions.querySelector<HTMLElement>("button")?.focus();
  }

  private async rename(run: Run): Promise<void> {
    const title = prompt("Title of this run", run.title)?.trim();
    if (title && title !== run.title) await this.do(() => api.rename(run.name, title.slice(0, 120)));
  }

  private async do(work: () => Promise<Run>): Promise<void> {
    if ((await this.notices.attempt(work)) !== undefined) await this.live.refresh();
  }

  private chosen(): string[] {
    const lines = this.settings.value.split("\n").map((line) => line.trim()).filter(Boolean);
    return this.mirror.checked ? [...lines, MIRROR] : lines;
  }
}

function gradeClass(run: Run): string {
  return { good: "good", usable: "warn", "do not measure": "bad", "": "plain" }[run.grade];
}
