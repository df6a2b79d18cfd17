/** Words about what went wrong or well, read aloud by screen readers, that stay until they are closed. */

import { Refusal, sentence } from "./api";
import { button, el } from "./dom";

export class Notices {
  readonly root = el("div", { class: "notices", role: "status", "aria-live": "polite" });

  /** Say something; `kind` is its colour, `offer` a button beside it. */
  say(text: string, kind: "info" | "bad" = "info", offer?: { title: string; take: () => Promise<void> }): void {
    for (const old of this.root.children) if (old.firstChild?.textContent === text) old.remove();
    const notice = el("div", { class: `notice ${kind}` }, el("p", {}, text));
    if (offer) notice.append(button(offer.title, () => offer.take().finally(() => notice.remove())));
    notice.append(button("Close", () => notice.remove(), { class: "plain", "aria-label": "Close this message" }));
    this.root.append(notice);
    if (kind === "info") setTimeout(() => notice.remove(), 8000);
  }

  /** Do something, and say what went wrong. */
  async attempt<Value>(work: () => Promise<Value>): Promise<Value | undefined> {
    try {
      return await work();
    } catch (error) {
      this.say(error instanceof Refusal ? error.message : sentence(`this page failed: ${String(error)}; reload it`), "bad");
      return undefined;
    }
  }
}
