/** The list of runs as it is now, for whoever listens: by server-sent events, or by asking where those do not come. */

import { api, Refusal, type Run } from "./api";

const POLL_MS = 1500;
const SILENCE_MS = 4000;
// Of EventSource, which a browser may lack.
const [OPEN, CLOSED] = [1, 2];

export class Live {
  runs: Run[] = [];
  /** Why nothing is heard from the server; empty while all is well. */
  trouble = "";
  private readonly listeners = new Set<() => void>();
  private source: EventSource | null = null;
  private heard = 0;
  private timer = 0;

  start(runs: Run[]): void {
    this.runs = runs;
    this.connect();
    this.timer = window.setInterval(() => void this.check(), POLL_MS);
    addEventListener("pagehide", () => {
      this.source?.close();
      clearInterval(this.timer);
    });
    // A browser opens six connections to one server: pages that nobody looks at must not hold them.
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) {
        this.source?.close();
        this.source = null;
      } else {
        this.connect();
        void this.refresh();
      }
    });
    addEventListener("pageshow", (event) => {
      if (event.persisted) location.reload();
    });
  }

  find(name: string): Run | undefined {
    return this.runs.find((run) => run.name === name);
  }

  /** Call a function now and after every change, until the function that is returned is called. */
  listen(listener: () => void): () => void {
    this.listeners.add(listener);
    listener();
    return () => this.listeners.delete(listener);
  }

  /** Ask at once: something was just done that changes a run. */
  async refresh(): Promise<void> {
    try {
      this.take(await api.runs(), "");
    } catch (error) {
      this.take(this.runs, error instanceof Refusal ? error.message : String(error));
    }
  }

  private connect(): void {
    if (typeof EventSource === "undefined" || document.hidden) return;
    this.source?.close();
    this.source = new EventSource("/api/events");
    this.source.addEventListener("runs", (event) => {
      this.heard = performance.now();
      this.take(JSON.parse((event as MessageEvent<string>).data) as Run[], "");
    });
  }

  private async check(): Promise<void> {
    if (document.hidden) return;
    const isOpen = this.source?.readyState === OPEN;
    if (isOpen && this.trouble === "") return;
    if (performance.now() - this.heard < SILENCE_MS && this.trouble === "") return;
    await this.refresh();
    if (this.trouble === "" && this.source?.readyState === CLOSED) this.connect();
  }

  private take(runs: Run[], trouble: string): void {
    this.runs = runs;
    this.trouble = trouble;
    for (const listener of [...this.listeners]) listener();
  }
}
