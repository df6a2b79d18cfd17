/** The sparse points of a run that goes on, turned by drag or arrow keys; drawn only when something has changed. */

import { el } from "./dom";

const SIZE = 420;
const VIRIDIS = ["#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725"];

export class Preview {
  readonly canvas = el("canvas", {
    tabindex: 0,
    role: "img",
    class: "preview",
    "aria-label": "Sparse points, coloured by height. Arrow keys turn them.",
  });
  private turn = 0.5;
  private lean = 1.05;
  private readonly centred: Float32Array;
  private readonly order: Uint32Array;
  private readonly reach: number;
  private readonly low: number;
  private readonly high: number;

  constructor(points: Float32Array) {
    const count = points.length / 3;
    const middle = [0, 1, 2].map((axis) => median(points, axis));
    this.centred = points.map((value, i) => value - middle[i % 3]!);
    const away = Float32Array.from({ length: count }, (_, i) => Math.hypot(this.centred[3 * i]!, this.centred[3 * i + 1]!));
    this.reach = Math.max(away.sort()[Math.floor(0.98 * (count - 1))] ?? 1, 1e-9);
    const heights = Float32Array.from({ length: count }, (_, i) => this.centred[3 * i + 2]!).sort();
    this.low = heights[Math.floor(0.02 * count)] ?? 0;
    this.high = heights[Math.floor(0.98 * count)] ?? 1;
    this.order = new Uint32Array(count);
    this.canvas.addEventListener("pointerdown", (event) => this.canvas.setPointerCapture(event.pointerId));
    this.canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) this.rotate(event.movementX / 150, event.movementY / 150);
    });
    this.canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
      if (!step) return;
      event.preventDefault();
      this.rotate(step[0]!, step[1]!);
    });
    this.draw();
  }

  private rotate(turn: number, lean: number): void {
    this.turn += turn;
    this.lean = Math.min(Math.PI / 2, Math.max(0, this.lean + lean));
    requestAnimationFrame(() => this.draw());
  }

  private draw(): void {
    const scale = Math.min(devicePixelRatio || 1, 2);
    this.canvas.width = this.canvas.height = SIZE * scale;
    const context = this.canvas.getContext("2d");
    if (context === null) return;
    const [cosT, sinT] = [Math.cos(this.turn), Math.sin(this.turn)];
    const [cosL, sinL] = [Math.cos(this.lean), Math.sin(this.lean)];
    const zoom = (0.47 * SIZE * scale) / this.reach;
    const depth = new Float32Array(this.order.length);
    const place = new Float32Array(2 * this.order.length);
    for (let i = 0; i < this.order.length; i++) {
      const [x, y, z] = [this.centred[3 * i]!, this.centred[3 * i + 1]!, this.centred[3 * i + 2]!];
      const [right, away] = [cosT * x - sinT * y, sinT * x + cosT * y];
      place[2 * i] = SIZE * scale * 0.5 + zoom * right;
      place[2 * i + 1] = SIZE * scale * 0.5 - zoom * (cosL * away + sinL * z);
      depth[i] = sinL * away - cosL * z;
      this.order[i] = i;
    }
    this.order.sort((a, b) => depth[b]! - depth[a]!);
    const dot = 1.6 * scale;
    for (const i of this.order) {
      const share = (this.centred[3 * i + 2]! - this.low) / (this.high - this.low || 1);
      context.fillStyle = VIRIDIS[Math.min(VIRIDIS.length - 1, Math.max(0, Math.floor(share * VIRIDIS.length)))]!;
      context.fillRect(place[2 * i]!, place[2 * i + 1]!, dot, dot);
    }
  }
}

function median(points: Float32Array, axis: number): number {
  const values = points.filter((_, i) => i % 3 === axis).sort();
  return values[values.length >> 1] ?? 0;
}
