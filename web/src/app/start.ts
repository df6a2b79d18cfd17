/** The frame of all pages: heading, messages, and the page that the address names. */

import { api } from "./api";
import { button, el, fill } from "./dom";
import { Live } from "./live";
import { Notices } from "./notice";
import { RunPage } from "./run_page";
import { RunsPage } from "./runs_page";
import { STYLES } from "./styles";
import { applyTheme, currentTheme, nextTheme } from "./theme";

interface Page {
  root: HTMLElement;
  title: string;
  leave(): void;
  setTheme?(): void;
}

export async function start(body: HTMLElement): Promise<void> {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(STYLES);
  document.adoptedStyleSheets = [...document.adoptedStyleSheets, sheet];
  applyTheme();
  const notices = new Notices();
  const live = new Live();
  const trouble = el("p", { class: "trouble", role: "alert", hidden: true });
  const main = el("main", { id: "main", tabindex: -1 });
  let page: Page | null = null;
  const theme = button(`Theme: ${currentTheme()}`, nextTheme, { class: "plain" });
  addEventListener("app-theme", () => {
    theme.textContent = `Theme: ${currentTheme()}`;
    page?.setTheme?.();
  });
  fill(
    body,
    el("a", { href: "#main", class: "skip", click: (event) => { event.preventDefault(); main.focus(); } }, "Skip to the content"),
    el("header", {}, el("a", { href: "#/", class: "brand" }, "semscape"), el("nav", { "aria-label": "Pages" },
      el("a", { href: "/api/docs", target: "_blank", rel: "noopener" }, "API")), theme),
    trouble,
    main,
    notices.root,
  );
  const state = await notices.attempt(() => api.state());
  if (state === undefined) return;
  live.start(state.runs);
  live.listen(() => {
    trouble.hidden = live.trouble === "";
    trouble.textContent = live.trouble;
  });
  const open = (): void => {
    page?.leave();
    const name = /^#\/run\/(.+)$/.exec(location.hash)?.[1];
    page = name === undefined ? new RunsPage(live, notices, state) : new RunPage(decoded(name), live, notices, state);
    document.title = `${page.title} – semscape`;
    fill(main, page.root);
    main.focus({ preventScroll: true });
    scrollTo(0, 0);
  };
  addEventListener("hashchange", open);
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => event.preventDefault()); // a file that misses must not replace the page
  open();
}

/** The name of a run in an address; as it stands there where the address was cut in the middle of a letter. */
function decoded(name: string): string {
  try {
    return decodeURIComponent(name);
  } catch {
    return name;
  }
}
