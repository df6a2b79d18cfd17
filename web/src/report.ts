/** The report's script: show the surface that the page carries in its element of class semscape-viewer. */

import { decodeSurface, mountViewer } from "./viewer";

async function start(): Promise<void> {
  const place = document.getElementById("semscape-viewer");
  const carried = document.getElementById("semscape-surface");
  if (!place || !carried) return;
  const text = atob((carried.textContent ?? "").trim());
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  carried.remove();
  mountViewer(place, await decodeSurface(bytes.buffer), {});
}

void start();
