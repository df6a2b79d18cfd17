/** A profile as a curve with its uncertainty. */

import { svg } from "./dom";
import { decimalsOf, fixed, ticks, tickStep } from "./numbers";
import type { Profile } from "./measure";

const WIDTH = 640;
const HEIGHT = 210;
const [LEFT, RIGHT, TOP, BOTTOM] = [58, 12, 10, 40];

/** Return the plot; `onHover` is told the index of the sample under the pointer, and null when it leaves. */
export function profilePlot(
  profile: Profile, sigma: Float64Array, sign: string, onHover: (index: number | null) => void,
): SVGElement {
  const { distance, height } = profile;
  let low = Infinity;
  let high = -Infinity;
  height.forEach((z, i) => {
    if (Number.isNaN(z)) return;
    const s = sigma[i] || 0;
    low = Math.min(low, z - s);
    high = Math.max(high, z + s);
  });
  if (!(high > low)) [low, high] = [(low || 0) - 1, (low || 0) + 1];
  const pad = 0.06 * (high - low);
  [low, high] = [low - pad, high + pad];
  const length = distance[distance.length - 1] || 1;
  const x = (d: number): number => LEFT + (d / length) * (WIDTH - LEFT - RIGHT);
  const y = (z: number): number => HEIGHT - BOTTOM - ((z - low) / (high - low)) * (HEIGHT - TOP - BOTTOM);
  const picture = svg("svg", {
    viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "sv-plot", role: "img",
    "aria-label": `Profile: height over ${fixed(length, decimalsOf(length / 1000))} ${sign}`,
  });
  for (const mark of ticks(low, high, 4)) {
    picture.append(svg("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y(mark), y2: y(mark), class: "sv-plot-grid" }));
  }
  axis(picture, [low, high, 4], (mark) => ({ x: LEFT - 7, y: y(mark) + 4, "text-anchor": "end" }));
  axis(picture, [0, length, 8], (mark) => ({ x: x(mark), y: HEIGHT - BOTTOM + 17, "text-anchor": "middle" }));
  const runs = knownRuns(height);
  const band = runs.map(([first, last]) => {
    const there: string[] = [];
    const back: string[] = [];
    for (let i = first; i <= last; i++) {
      const s = sigma[i] || 0;
      there.push(`${x(distance[i]).toFixed(1)} ${y(height[i] + s).toFixed(1)}`);
      back.unshift(`${x(distance[i]).toFixed(1)} ${y(height[i] - s).toFixed(1)}`);
    }
    return `M${there.join("L")}L${back.join("L")}Z`;
  });
  const curve = runs.map(([first, last]) => {
    const there: string[] = [];
    for (let i = first; i <= last; i++) there.push(`${x(distance[i]).toFixed(1)} ${y(height[i]).toFixed(1)}`);
    return `M${there.join("L")}`;
  });
  picture.append(svg("path", { d: band.join(""), class: "sv-plot-band" }));
  picture.append(svg("path", { d: curve.join(""), class: "sv-plot-curve" }));
  picture.append(words(`Distance (${sign})`, { x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 5, "text-anchor": "middle" }));
  const turned = words(`Height (${sign})`, { "text-anchor": "middle" });
  turned.setAttribute("transform", `translate(13 ${(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)`);
  picture.append(turned);
  const line = svg("line", { y1: TOP, y2: HEIGHT - BOTTOM, class: "sv-plot-cursor", visibility: "hidden" });
  picture.append(line);
  picture.addEventListener("pointermove", (event) => {
    const box = picture.getBoundingClientRect();
    const share = ((event.clientX - box.left) / box.width) * WIDTH;
    const index = Math.round(((share - LEFT) / (WIDTH - LEFT - RIGHT)) * (distance.length - 1));
    const inside = index >= 0 && index < distance.length;
    line.setAttribute("visibility", inside ? "visible" : "hidden");
    if (inside) for (const end of ["x1", "x2"]) line.setAttribute(end, String(x(distance[index])));
    onHover(inside ? index : null);
  });
  picture.addEventListener("pointerleave", () => {
    line.setAttribute("visibility", "hidden");
    onHover(null);
  });
  return picture;
}

function axis(picture: SVGElement, [low, high, count]: [number, number, number], place: (mark: number) => Record<string, string | number>): void {
  const decimals = decimalsOf(tickStep(low, high, count));
  for (const mark of ticks(low, high, count)) picture.append(words(fixed(mark, decimals), place(mark)));
}

function words(text: string, place: Record<string, string | number>): SVGElement {
  const element = svg("text", place);
  element.textContent = text;
  return element;
}

function knownRuns(height: Float64Array): [number, number][] {
  const runs: [number, number][] = [];
  height.forEach((z, i) => {
    if (Number.isNaN(z)) return;
    const last = runs[runs.length - 1];
    if (last && last[1] === i - 1) last[1] = i;
    else runs.push([i, i]);
  });
  return runs;
}
