/** The first page: where images are dropped, and all runs. */

import { address, api, type AppState, type Removed, type Run } from "./api";
import { button, el, fill } from "./dom";
import type { Live } from "./live";
import type { Notices } from "./notice";
import { DropZone } from "./upload";
import { figuresText, plural, stageText, stateText } from "./words";

export class RunsPage {
  readonly root = el("div", { class: "page" });
  readonly title = "Runs";
  private readonly list = el("ul", { class: "runs" });
  private readonly removed = el("details", { hidden: true });
  private readonly stop: () => void;
  private shown = "";
  private listed: string | null = null;

  constructor(
    private readonly live: Live,
    private readonly notices: Notices,
    state: AppState,
  ) {
    const drop = new DropZone(
      state,
      notices,
      "Drop the images of one specimen here, one image for each tilt.",
      async (title) => (await api.create(title)).name,
      (name) => {
        void live.refresh().then(() => {
          location.hash = `#/run/${encodeURIComponent(name)}`;
        });
      },
    );
    drop.accept(this.root);
    this.root.append(
      el("h1", {}, "From tilted SEM images to a measured surface"),
      drop.root,
      el("h2", { id: "runs-heading" }, "Runs"),
      this.list,
      el("p", { class: "quiet" }, "Runs are folders in ", el("code", {}, state.workspace), ". What is made there by ",
        el("code", {}, "semscape reconstruct"), " is listed as well."),
      this.removed,
    );
    this.stop = live.listen(() => this.update());
  }

  leave(): void {
    this.stop();
  }

  private update(): void {
    const now = JSON.stringify(this.live.runs);
    if (now === this.shown) return;
    this.shown = now;
    const focused = document.activeElement?.getAttribute("data-focus");
    const busy = { running: 0, queued: 1 } as Record<string, number>;
    const runs = [...this.live.runs].sort((a, b) => (busy[a.state] ?? 2) - (busy[b.state] ?? 2) || a.place - b.place);
    fill(
      this.list,
      ...(runs.length === 0 ? [el("li", { class: "quiet none" }, "There are none yet.")] : runs.map((run) => this.item(run))),
    );
    const names = runs.map((run) => run.name).join("\n");
    if (names !== this.listed) void this.listRemoved();
    this.listed = names;
    if (focused) this.list.querySelector<HTMLElement>(`[data-focus="${CSS.escape(focused)}"]`)?.focus();
  }

  private item(run: Run): HTMLElement {
    const href = `#/run/${encodeURIComponent(run.name)}`;
    const picture = run.has_result
      ? el("img", { src: `${address(run.name, "thumbnail")}?${run.revision}`, alt: "", loading: "lazy" })
      : run.picture
        ? el("img", { src: address(run.name, "images", run.picture), alt: "", loading: "lazy" })
        : el("span", { class: "no-picture", "aria-hidden": "true" });
    const stage = run.stages.find((one) => one.state === "running");
    const told = run.message || (stage ? `${stageText(stage)} …` : run.has_result ? run.verdict : lastFigures(run));
    return el(
      "li",
      { class: `run ${run.state}` },
      picture,
      el(
        "div",
        { class: "about" },
        el("a", { href, class: "name", "data-focus": `open ${run.name}` }, run.title),
        el("p", { class: "quiet" }, el("span", { class: `chip ${chipClass(run)}` }, chipText(run)), " ",
          plural(run.n_images, "image")),
        told ? el("p", { class: "told" }, told) : null,
      ),
      el("div", { class: "row" }, this.removal(run)),
    );
  }

  private removal(run: Run): HTMLElement | null {
    const label = (what: string) => ({ "aria-label": `${what} ${run.title}`, "data-focus": `${what} ${run.name}` });
    if (run.state === "running" || run.state === "queued") {
      return button("Cancel", async () => void (await this.notices.attempt(() => api.cancel(run.name))), label("Cancel"));
    }
    return button(
      "Remove",
      async () => {
        const gone = await this.notices.attempt(() => api.remove(run.name));
        await this.live.refresh();
        if (gone) this.notices.say(`“${gone.title}” was removed.`, "info", { title: "Undo", take: () => this.restore(gone) });
      },
      { class: "plain", ...label("Remove") },
    );
  }

  private async restore(gone: Removed): Promise<void> {
    await this.notices.attempt(() => api.restore(gone.key));
    await this.live.refresh();
  }

  /** Show what was removed, which stays in the workspace until a person deletes it. */
  private async listRemoved(): Promise<void> {
    const removed = (await this.notices.attempt(() => api.removed())) ?? [];
    this.removed.hidden = removed.length === 0;
    fill(
      this.removed,
      el("summary", {}, `Removed runs (${removed.length})`),
      el("p", { class: "quiet" }, "They are in the folder “removed” of the workspace; delete them there."),
      el("ul", { class: "removed" }, ...removed.map((gone) =>
        el("li", { class: "row" },
          el("span", { class: "grow" }, gone.title, " ", el("span", { class: "quiet" }, new Date(1000 * gone.removed_s).toLocaleString())),
          button("Restore", () => this.restore(gone), { "aria-label": `Restore ${gone.title}` })))),
    );
  }
}

/** What a run's chip says: how far it may be trusted, where it has a result. */
export function chipText(run: Run): string {
  if (run.state === "done" && run.grade) return run.grade;
  return stateText(run);
}

export function chipClass(run: Run): string {
  if (run.state === "done") return { good: "good", usable: "warn", "do not measure": "bad", "": "" }[run.grade];
  if (run.state === "failed") return "bad";
  return run.state === "running" ? "busy" : "";
}

function lastFigures(run: Run): string {
  const done = run.stages.filter((stage) => stage.state === "done");
  const last = done[done.length - 1];
  return last ? figuresText(last) : "";
}
