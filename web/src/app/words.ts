/** How states, stages and numbers are put into words. */

import type { Run, Stage, State } from "./api";

const STATES: Record<State, string> = {
  draft: "not reconstructed yet",
  queued: "waiting",
  running: "reconstructing",
  done: "done",
  failed: "failed",
  cancelled: "cancelled",
};

const STAGES: Record<string, string> = {
  detect: "Find keypoints",
  match: "Match the images in pairs",
  calibrate: "Find the tilts and the sparse points",
  surface: "Match every pixel",
  mesh: "Make the mesh",
  report: "Write the report",
};

/** One of the states, with the place in the queue. */
export function stateText(run: Run): string {
  if (run.state === "queued" && run.place > 1) return `waiting, ${run.place - 1} before it`;
  return STATES[run.state];
}

export function stageText(stage: Stage): string {
  return STAGES[stage.name] ?? stage.name;
}

/** The figures of a stage that say something to its user. */
export function figuresText(stage: Stage): string {
  const { n_keypoints, n_inliers, n_pairs, n_tracks, rms_px, completeness, n_vertices } = stage.figures;
  const parts: string[] = [];
  if (isNumber(n_keypoints)) parts.push(`${n_keypoints.toLocaleString("en")} keypoints`);
  if (isNumber(n_inliers)) parts.push(`${n_inliers.toLocaleString("en")} matches`);
  if (isNumber(n_pairs)) parts.push(`${n_pairs} pairs`);
  if (isNumber(n_tracks)) parts.push(`${n_tracks.toLocaleString("en")} points`);
  if (isNumber(rms_px)) parts.push(`residual ${rms_px.toFixed(2)} px`);
  if (isNumber(completeness)) parts.push(`${(100 * completeness).toFixed(0)} % of the field`);
  if (isNumber(n_vertices)) parts.push(`${n_vertices.toLocaleString("en")} vertices`);
  return parts.join(", ");
}

export function duration(seconds: number | null): string {
  if (seconds === null) return "";
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 100) return `${seconds.toFixed(0)} s`;
  return `${Math.floor(seconds / 60)} min ${Math.round(seconds % 60)} s`;
}

/** A number with so many digits that count, "–" where it is unknown. */
export function number(value: unknown, digits = 4): string {
  if (!isNumber(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size < 1e-4 || size >= 1e7) return value.toExponential(digits - 1);
  const decimals = Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  const text = value.toFixed(Math.min(decimals, 20));
  return text.includes(".") ? text.replace(/\.?0+$/, "") : text;
}

/** A value to the place of its uncertainty's second digit, and the uncertainty. */
export function withSigma(value: number | null, sigma: number | null): [string, string] {
  if (!isNumber(value)) return ["unknown", ""];
  if (!isNumber(sigma) || sigma <= 0) return [number(value), ""];
  const places = 1 - Math.floor(Math.log10(sigma));
  if (places < 0 || places > 9) return [number(value, 6), number(sigma, 2)];
  return [value.toFixed(places), sigma.toFixed(places)];
}

export function unitText(unit: string): string {
  return unit.replace(/um/g, "µm");
}

export function isNumber(value: unknown): value is number {
  return typeof value === "number" && Number.isFinite(value);
}

export function plural(count: number, word: string): string {
  return `${count} ${word}${count === 1 ? "" : "s"}`;
}
