/** The files that were dropped or chosen, those in folders too, sorted into what a series takes and what it does not. */

const IMAGE = /\.(tiff?|png|jpe?g|bmp)$/i;
const BESIDE_IMAGES = /\.(txt|hdr)$/i;

export interface Chosen {
  title: string;
  files: File[];
  ignored: string[];
}

/** Choose what belongs to one series; texts only where an image is named like them. */
export function choose(files: File[], folder: string): Chosen {
  const images = files.filter((file) => IMAGE.test(file.name));
  const stems = images.map((file) => stem(file.name));
  const texts = files.filter(
    (file) => BESIDE_IMAGES.test(file.name) && stems.some((name) => stem(file.name).startsWith(name)),
  );
  const toml = files.filter((file) => file.name.toLowerCase() === "series.toml");
  const sorted = [...images, ...texts].sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));
  const taken = new Set([...sorted, ...toml]);
  return {
    title: folder || commonStart(images.map((file) => stem(file.name))) || "series",
    files: [...sorted, ...toml],
    ignored: files.filter((file) => !taken.has(file) && !file.name.startsWith(".")).map((file) => file.name),
  };
}

/** The files of a drop, with those directly in the folders that were dropped, and the name of a single such folder. */
export async function dropped(transfer: DataTransfer): Promise<{ files: File[]; folder: string }> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.() ?? null);
  if (entries.every((entry) => entry === null)) return { files: [...transfer.files], folder: "" };
  const files: File[] = [];
  for (const entry of entries) {
    if (entry?.isFile) files.push(await fileOf(entry as FileSystemFileEntry));
    else if (entry?.isDirectory) files.push(...(await filesIn(entry as FileSystemDirectoryEntry)));
  }
  const folders = entries.filter((entry) => entry?.isDirectory);
  return { files, folder: folders.length === 1 ? folders[0]!.name : "" };
}

/** The files directly in a folder that was chosen, and its name. */
export function inFolder(files: FileList): { files: File[]; folder: string } {
  const all = [...files];
  const parts = all.map((file) => file.webkitRelativePath.split("/"));
  return { files: all.filter((_, i) => parts[i]!.length <= 2), folder: parts[0]?.[0] ?? "" };
}

async function filesIn(folder: FileSystemDirectoryEntry): Promise<File[]> {
  const reader = folder.createReader();
  const found: FileSystemEntry[] = [];
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (some.length === 0) break; // browsers give a hundred at a time
    found.push(...some);
  }
  return Promise.all(found.filter((entry) => entry.isFile).map((entry) => fileOf(entry as FileSystemFileEntry)));
}

function fileOf(entry: FileSystemFileEntry): Promise<File> {
  return new Promise((resolve, reject) => entry.file(resolve, reject));
}

function stem(name: string): string {
  return name.replace(/\.[^.]*$/, "");
}

function commonStart(names: string[]): string {
  let start = names[0] ?? "";
  for (const name of names) while (!name.startsWith(start)) start = start.slice(0, -1);
  return start.replace(/[\s_.\-0]+$/, "");
}
