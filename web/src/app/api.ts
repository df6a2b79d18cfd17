/** What the server is asked for, and what it answers; the same names as in /api/docs. */

export type State = "draft" | "queued" | "running" | "done" | "failed" | "cancelled";

export interface Stage {
  name: string;
  state: "waiting" | "running" | "done";
  seconds: number | null;
  figures: Record<string, unknown>;
}

export interface Run {
  name: string;
  title: string;
  state: State;
  place: number;
  n_images: number;
  has_images: boolean;
  has_result: boolean;
  is_stale: boolean;
  grade: "good" | "usable" | "do not measure" | "";
  verdict: string;
  message: string;
  settings: string[];
  sign_is_assumed: boolean;
  picture: string;
  has_preview: boolean;
  stages: Stage[];
  revision: string;
}

export interface AppState {
  version: string;
  workspace: string;
  max_file_mb: number;
  max_files: number;
  max_run_mb: number;
  formats: string[];
  runs: Run[];
}

export interface Removed {
  key: string;
  title: string;
  removed_s: number;
}

export type Cell = number | boolean | null;

export interface Row {
  image: string;
  original: string;
  understood: Record<string, unknown>;
  told: Record<string, unknown>;
}

export interface SeriesTable {
  rows: Row[];
  told: Record<string, unknown>;
  warnings: string[];
  problem: string;
  width: number;
  height: number;
  length_unit: "um" | "px";
  can_undo: boolean;
  can_redo: boolean;
}

export interface Figure {
  group: string;
  name: string;
  value: number | null;
  unit: string;
  meaning: string;
  sigma: number | null;
}

export interface Measurement {
  length_unit: "um" | "px";
  figures: Figure[];
  warnings: string[];
}

/** A refusal of the server, in words that say what to do. */
export class Refusal extends Error {
  constructor(
    message: string,
    readonly status: number,
  ) {
    super(message);
  }
}

const CLOSED =
  "The app has ended, or was started anew. Start semscape app again and open the address that it prints. " +
  "Nothing is lost: runs and edits are on disk.";

async function ask(method: string, path: string, body?: unknown): Promise<Response> {
  const isFile = body instanceof Blob;
  const request: RequestInit = { method };
  if (body !== undefined) {
    request.body = isFile ? body : JSON.stringify(body);
    request.headers = { "Content-Type": isFile ? "application/octet-stream" : "application/json" };
  }
  let answer: Response;
  try {
    answer = await fetch(path, request);
  } catch {
    throw new Refusal(CLOSED, 0);
  }
  if (answer.ok) return answer;
  if (answer.status === 401) throw new Refusal(CLOSED, 401);
  let words = `The server answered ${answer.status} ${answer.statusText}.`;
  try {
    words = sentence(String(((await answer.json()) as { detail: unknown }).detail));
  } catch {
    // Not one of the app's own answers: its number says more than its text.
  }
  throw new Refusal(words, answer.status);
}

async function json<Value>(method: string, path: string, body?: unknown): Promise<Value> {
  return (await (await ask(method, path, body)).json()) as Value;
}

/** Address of a run, or of something of it. */
export function address(name: string, ...rest: string[]): string {
  return ["/api/runs", ...[name, ...rest].map(encodeURIComponent)].join("/");
}

export const api = {
  state: () => json<AppState>("GET", "/api/state"),
  runs: () => json<Run[]>("GET", "/api/runs"),
  create: (title: string) => json<Run>("POST", "/api/runs", { title }),
  rename: (name: string, title: string) => json<Run>("PUT", address(name), { title }),
  remove: (name: string) => json<Removed>("DELETE", address(name)),
  removed: () => json<Removed[]>("GET", "/api/removed"),
  restore: (key: string) => json<Run>("POST", `/api/removed/${encodeURIComponent(key)}/restore`),
  upload: (name: string, file: File) =>
    json<Run>("PUT", `${address(name, "files")}?filename=${encodeURIComponent(file.name)}`, file),
  removeImage: (name: string, image: string) => json<Run>("DELETE", address(name, "files", image)),
  series: (name: string) => json<SeriesTable>("GET", address(name, "series")),
  edit: (name: string, image: string, key: string, value: Cell) =>
    json<SeriesTable>("PUT", address(name, "cells"), { image, key, value }),
  undo: (name: string) => json<SeriesTable>("POST", address(name, "undo")),
  redo: (name: string) => json<SeriesTable>("POST", address(name, "redo")),
  reconstruct: (name: string, settings: string[]) => json<Run>("POST", address(name, "reconstruct"), { settings }),
  cancel: (name: string) => json<Run>("POST", address(name, "cancel")),
  preview: async (name: string) => new Float32Array(await (await ask("GET", address(name, "preview"))).arrayBuffer()),
  surface: async (name: string) => (await ask("GET", address(name, "surface"))).arrayBuffer(),
  result: (name: string) => json<Record<string, unknown>>("GET", address(name, "result")),
  measure: (name: string, question: Record<string, unknown>) =>
    json<Measurement>("POST", address(name, "measure"), question),
  exported: async (name: string, format: string): Promise<{ blob: Blob; filename: string }> => {
    const answer = await ask("GET", address(name, "export", format));
    const told = /filename="?([^";]+)/.exec(answer.headers.get("content-disposition") ?? "");
    return { blob: await answer.blob(), filename: told?.[1] ?? `${name}.${format}` };
  },
};

/** A text with a capital at its beginning and a stop at its end. */
export function sentence(text: string): string {
  const trimmed = text.trim();
  if (!trimmed) return "";
  const first = /^[a-z]+(?=[\s,:])/.test(trimmed) ? trimmed[0]!.toUpperCase() + trimmed.slice(1) : trimmed;
  return /[.!?:]$/.test(first) ? first : `${first}.`;
}
