/** Light or dark: as the system has it, or as was chosen here. */

import type { Theme } from "../viewer";

const KEY = "semscape theme";
const NEXT: Record<Theme, Theme> = { auto: "light", light: "dark", dark: "auto" };

export function currentTheme(): Theme {
  const kept = localStorage.getItem(KEY);
  return kept === "light" || kept === "dark" ? kept : "auto";
}

/** Take the next of the three and return it. */
export function nextTheme(): Theme {
  const theme = NEXT[currentTheme()];
  localStorage.setItem(KEY, theme);
  applyTheme();
  return theme;
}

export function applyTheme(): void {
  const theme = currentTheme();
  document.documentElement.style.colorScheme = theme === "auto" ? "light dark" : theme;
}
