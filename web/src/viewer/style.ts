/** The viewer's style sheet, adopted by the document: so it needs no permission of a content security policy. */

import text from "./style.css";

let installed = false;

export function installStyle(): void {
  if (installed) return;
  installed = true;
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(text);
  document.adoptedStyleSheets = [...document.adoptedStyleSheets, sheet];
}
