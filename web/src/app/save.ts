/** Give a file to the browser to save. */

import { el } from "./dom";

export function save(blob: Blob, filename: string): void {
  const href = URL.createObjectURL(blob);
  const link = el("a", { href, download: filename });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(href), 60_000);
}
