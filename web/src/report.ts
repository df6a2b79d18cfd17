/** The report's script: show the surface that the page carries in its element of class semscape-viewer. */

import { decodeSurface, mountViewer } from "./viewer";

async function start(): Promise<void> {
  const place = document.getElementById("semscape-viewer");
  const carried = document.getElementById("semscape-surface");
  if (!place || !carried) return;
  const text = atob((carried.textContent ?? "").trim());
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  carried.remove();
  place.addEventListener("semscape-theme", (event) => {
    document.documentElement.dataset.theme = (event as CustomEvent<string>).detail;
  });
  mountViewer(place, await decodeSurface(bytes.buffer), { label: "Surface of the run" });
  // The still pictures are then for paper only.
  document.documentElement.classList.add("has-viewer");
}

start().catch((error: unknown) => {
  const place = document.getElementById("semscape-viewer");
  // The still pictures below say the rest.
  if (place) place.textContent = `The viewer cannot show the surface: ${error instanceof Error ? error.message : error}`;
});
