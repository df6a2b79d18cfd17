/** A run that waits or is being made: its stages, and its points as soon as they are there. */

import { api, type Run } from "./api";
import { el, fill } from "./dom";
import { Preview } from "./preview";
import { duration, figuresText, plural, stageText, stateText } from "./words";

const MARKS = { waiting: "○", running: "◐", done: "●" };

const MOST_FAILURES = 3;

export class Progress {
  readonly root = el("section", { class: "card progress", "aria-labelledby": "progress-heading" });
  private readonly heading = el("h2", { id: "progress-heading" });
  private readonly stages = el("ol", { class: "stages" });
  private readonly spoken = el("p", { class: "unseen", "aria-live": "polite" });
  private readonly picture = el("div", { class: "preview-place" });
  private asked = "";
  private failures = 0;

  constructor() {
    this.root.append(this.heading, this.spoken, el("div", { class: "beside" }, this.stages, this.picture));
  }

  update(run: Run): void {
    const isShown = run.state === "queued" || run.state === "running" || (run.stages.length > 0 && !run.has_result);
    this.root.hidden = !isShown;
    if (!isShown) {
      this.asked = "";
      fill(this.picture);
      return;
    }
    this.heading.textContent = run.state === "queued" ? `In the queue: ${stateText(run)}` : "Stages";
    fill(
      this.stages,
      ...run.stages.map((stage) =>
        el(
          "li",
          { class: stage.state, "aria-current": stage.state === "running" ? "step" : null },
          el("span", { class: "mark", "aria-hidden": "true" }, MARKS[stage.state]),
          el("span", { class: "stage" }, stageText(stage)),
          el("span", { class: "quiet" }, figuresText(stage)),
          el("span", { class: "time" }, duration(stage.seconds)),
        ),
      ),
    );
    const current = run.stages.find((stage) => stage.state === "running");
    const said = current ? stageText(current) : "";
    if (this.spoken.textContent !== said) this.spoken.textContent = said;
    if (run.has_preview && this.asked !== run.name && this.failures < MOST_FAILURES) void this.preview(run.name);
  }

  private async preview(name: string): Promise<void> {
    this.asked = name;
    try {
      const points = await api.preview(name);
      if (this.asked !== name || points.length === 0) return;
      fill(
        this.picture,
        new Preview(points).canvas,
        el("p", { class: "quiet" }, `Preview: ${plural(points.length / 3, "sparse point")}; drag or use the arrow keys to turn.`),
      );
      this.failures = 0;
    } catch (error) {
      // The run may have ended meanwhile, and its surface is shown instead; else one more try may do.
      this.asked = "";
      this.failures += 1;
      if (this.failures === MOST_FAILURES)
        fill(this.picture, el("p", { class: "quiet" }, `No preview of the sparse points: ${(error as Error).message}`));
    }
  }
}
