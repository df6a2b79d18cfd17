/** Light or dark: as the system has it, or as was chosen here. */

import type { Theme } from "../viewer";

const KEY = "semscape theme";
const NEXT: Record<Theme, Theme> = { auto: "light", light: "dark", dark: "auto" };

export function currentTheme(): Theme {
  const kept = localStorage.getItem(KEY);
  return kept === "light" || kept === "dark" ? kept : "auto";
}

/** Take one of the three, and tell the page. */
export function chooseTheme(theme: Theme): void {
  if (theme === currentTheme()) return;
  localStorage.setItem(KEY, theme);
  applyTheme();
  dispatchEvent(new CustomEvent("app-theme"));
}

/** Take the next of the three. */
export function nextTheme(): void {
  chooseTheme(NEXT[currentTheme()]);
}

export function applyTheme(): void {
  const theme = currentTheme();
  document.documentElement.style.colorScheme = theme === "auto" ? "light dark" : theme;
}
