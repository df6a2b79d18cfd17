/** Send files to a run, one after the other, and say how far it is. */

import { api, type AppState } from "./api";
import { el } from "./dom";
import { choose, dropped, inFolder } from "./files";
import type { Notices } from "./notice";
import { plural } from "./words";

let sending = 0;
addEventListener("beforeunload", (event) => {
  if (sending > 0) event.preventDefault(); // what is not copied yet would be missing
});

/** An area that takes files by drop, by choice and by keyboard; `begin` returns the run that they belong to. */
export class DropZone {
  readonly root: HTMLElement;
  private readonly progress = el("p", { class: "quiet", "aria-live": "polite" });

  constructor(
    private readonly limits: AppState,
    private readonly notices: Notices,
    words: string,
    private readonly begin: (title: string) => Promise<string>,
    private readonly end: (name: string) => void,
  ) {
    const files = el("input", { type: "file", multiple: true, class: "unseen", id: unique(), accept: ACCEPTED });
    const folder = el("input", { type: "file", webkitdirectory: true, class: "unseen", id: unique() });
    files.addEventListener("change", () => void this.take([...(files.files ?? [])], "").then(() => (files.value = "")));
    folder.addEventListener("change", () => {
      if (!folder.files?.length) return;
      const chosen = inFolder(folder.files);
      void this.take(chosen.files, chosen.folder).then(() => (folder.value = ""));
    });
    this.root = el(
      "div",
      { class: "drop" },
      el("p", { class: "drop-words" }, words),
      el(
        "div",
        { class: "row" },
        el("label", { class: "button primary", for: files.id }, files, "Choose images"),
        el("label", { class: "button", for: folder.id }, folder, "Choose a folder"),
      ),
      this.progress,
    );
    this.accept(this.root);
  }

  /** Let an element take drops as well. */
  accept(element: HTMLElement): void {
    element.addEventListener("dragover", (event) => {
      event.preventDefault();
      this.root.classList.add("over");
    });
    element.addEventListener("dragleave", () => this.root.classList.remove("over"));
    element.addEventListener("drop", (event) => {
      event.preventDefault();
      event.stopPropagation();
      this.root.classList.remove("over");
      if (event.dataTransfer === null) return;
      void dropped(event.dataTransfer).then(({ files, folder }) => this.take(files, folder));
    });
  }

  private async take(files: File[], folder: string): Promise<void> {
    const chosen = choose(files, folder);
    if (chosen.files.length === 0) {
      if (files.length > 0) this.notices.say("There are no images among these files: TIFF, PNG, JPEG and BMP are read.", "bad");
      return;
    }
    if (chosen.files.length > this.limits.max_files) {
      const most = this.limits.max_files;
      this.notices.say(`These are ${chosen.files.length} files; a run takes at most ${most}. Choose one series.`, "bad");
      return;
    }
    sending += 1;
    const name = await this.notices.attempt(() => this.begin(chosen.title));
    let sent = 0;
    for (const file of name === undefined ? [] : chosen.files) {
      this.progress.textContent = `Copying ${sent + 1} of ${plural(chosen.files.length, "file")}: ${file.name}`;
      if ((await this.notices.attempt(() => api.upload(name!, file))) !== undefined) sent += 1;
    }
    sending -= 1;
    this.progress.textContent = "";
    if (chosen.ignored.length > 0) {
      const named = chosen.ignored.slice(0, 3).join(", ") + (chosen.ignored.length > 3 ? ", …" : "");
      this.notices.say(`${plural(chosen.ignored.length, "file")} left out, for they are no images: ${named}`);
    }
    if (name !== undefined) this.end(name);
  }
}

const ACCEPTED = ".tif,.tiff,.png,.jpg,.jpeg,.bmp,.txt,.hdr,.toml";
let count = 0;

export function unique(): string {
  count += 1;
  return `field-${count}`;
}
