/** What was typed but is not on the server yet stays over a reload of the page, as long as its tab is open. */

type Field = HTMLInputElement | HTMLSelectElement | HTMLTextAreaElement;

/** Fill fields with what was kept under a name, and keep what is typed into them from now on; returns a function that keeps it at once. */
export function keepFields(name: string, fields: Field[]): () => void {
  const kept = keptValue<(string | boolean)[]>(name);
  fields.forEach((field, i) => {
    const value = kept?.[i];
    if (typeof value === "boolean") (field as HTMLInputElement).checked = value;
    else if (value !== undefined) field.value = value;
  });
  const keep = (): void =>
    keepValue(name, fields.map((field) => (field instanceof HTMLInputElement && field.type === "checkbox" ? field.checked : field.value)));
  for (const field of fields) field.addEventListener("input", keep);
  return keep;
}

export function keepValue(name: string, value: unknown): void {
  sessionStorage.setItem(name, JSON.stringify(value));
}

export function keptValue<Value>(name: string): Value | null {
  const text = sessionStorage.getItem(name);
  return text === null ? null : (JSON.parse(text) as Value);
}
