/** The look of the app's pages; the viewer has its own. */

export const STYLES = `
:root {
  color-scheme: light dark;
  --ground: light-dark(#f5f6f8, #0f1318); --card: light-dark(#ffffff, #171c23); --ink: light-dark(#1b2129, #e6eaef);
  --quiet: light-dark(#55606c, #a0abb8); --line: light-dark(#d9dee4, #2e3741); --field: light-dark(#868f9a, #6b7785);
  --accent: light-dark(#155fa8, #69aef5); --on-accent: light-dark(#ffffff, #0b1a2b);
  --good: light-dark(#176640, #6fd3a0); --warn: light-dark(#7d4900, #f0bd6a); --bad: light-dark(#a3201a, #ff9a91);
  --good-ground: light-dark(#e4f4ec, #14291f); --warn-ground: light-dark(#fdf1dc, #2d2413);
  --bad-ground: light-dark(#fbe6e4, #331a18); --busy-ground: light-dark(#e3eefb, #14263a);
}
* { box-sizing: border-box; }
[hidden] { display: none !important; }
body {
  margin: 0; background: var(--ground); color: var(--ink); overflow-wrap: anywhere;
  font: 1rem/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
}
:focus-visible { outline: 3px solid var(--accent); outline-offset: 2px; }
main:focus { outline: none; }
.skip { position: absolute; left: -100vw; }
.skip:focus { left: 1rem; top: 0.5rem; background: var(--card); padding: 0.4rem 0.8rem; z-index: 10; }
.unseen { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); white-space: nowrap; }
header { display: flex; gap: 1.2rem; align-items: center; padding: 0.7rem 1.5rem; border-bottom: 1px solid var(--line); background: var(--card); }
header nav { margin-left: auto; }
.brand { font-weight: 750; font-size: 1.15rem; letter-spacing: -0.01em; color: var(--accent); text-decoration: none; }
main { max-width: 84rem; margin: 0 auto; padding: 1.2rem 1.5rem 4rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0.3rem 0 0.8rem; letter-spacing: -0.01em; }
h2 { font-size: 1.15rem; margin: 1.6rem 0 0.6rem; }
h3 { font-size: 0.95rem; margin: 0.9rem 0 0.3rem; color: var(--quiet); }
p { margin: 0.3rem 0; }
a { color: var(--accent); }
code { font: 0.92em ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; }
.quiet { color: var(--quiet); font-size: 0.92rem; }
.grow { flex: 1 1 auto; }
.row { display: flex; flex-wrap: wrap; gap: 0.6rem; align-items: center; }
.actions { margin: 0.9rem 0; }
.check { display: inline-flex; gap: 0.45rem; align-items: center; }
button, .button {
  font: inherit; font-weight: 600; color: var(--ink); background: var(--card); border: 1px solid var(--field); border-radius: 8px;
  padding: 0.36rem 0.95rem; cursor: pointer; text-decoration: none; display: inline-block; min-height: 2.3rem;
}
button:hover:not(:disabled), .button:hover { border-color: var(--accent); color: var(--accent); }
button.primary, .button.primary { background: var(--accent); border-color: var(--accent); color: var(--on-accent); }
button.primary:hover:not(:disabled), .button.primary:hover { color: var(--on-accent); filter: brightness(1.1); }
button.plain { border-color: transparent; background: none; font-weight: 500; color: var(--accent); padding: 0.3rem 0.5rem; }
button, .button { white-space: nowrap; }
.run .row { flex: none; }
button:disabled { opacity: 0.5; cursor: default; }
.button:focus-within { outline: 3px solid var(--accent); outline-offset: 2px; }
input[type="text"], select, textarea {
  font: inherit; color: inherit; background: var(--card); border: 1px solid var(--field); border-radius: 6px; padding: 0.28rem 0.5rem;
}
input[type="text"]:disabled { background: var(--ground); color: var(--quiet); }
input.told { border: 2px solid var(--accent); font-weight: 650; }
input[aria-invalid="true"] { border: 2px solid var(--bad); }
input[type="checkbox"] { width: 1.1rem; height: 1.1rem; accent-color: var(--accent); }
textarea { width: 100%; font-family: ui-monospace, monospace; }
.card, .drop {
  background: var(--card); border: 1px solid var(--line); border-radius: 12px; padding: 1rem 1.2rem; margin: 1rem 0;
}
.card > h2:first-child { margin-top: 0; }
details.card > summary h2 { display: inline; margin: 0; }
summary { cursor: pointer; }
.drop { border: 2px dashed var(--field); text-align: center; padding: 1.6rem 1.2rem; }
.drop .row { justify-content: center; margin: 0.6rem 0 0; }
.drop-words { font-size: 1.08rem; }
details .drop { padding: 0.8rem; }
.drop.over { border-color: var(--accent); background: var(--busy-ground); }
.chip {
  display: inline-block; padding: 0 0.6rem; border-radius: 1rem; font-size: 0.86rem; line-height: 1.6rem; font-weight: 600;
  background: var(--ground); border: 1px solid var(--line); vertical-align: middle; letter-spacing: 0;
}
.chip.good, .banner.good { background: var(--good-ground); color: var(--good); border-color: transparent; }
.chip.warn, .banner.warn { background: var(--warn-ground); color: var(--warn); border-color: transparent; }
.chip.bad, .banner.bad { background: var(--bad-ground); color: var(--bad); border-color: transparent; }
.chip.busy { background: var(--busy-ground); color: var(--accent); border-color: transparent; }
.banner { padding: 0.55rem 0.9rem; border-radius: 8px; border: 1px solid var(--line); font-weight: 550; max-width: 75rem; }
.runs { list-style: none; margin: 0; padding: 0; display: grid; gap: 0.7rem; grid-template-columns: repeat(auto-fill, minmax(min(26rem, 100%), 1fr)); }
.run { position: relative; display: flex; gap: 1rem; align-items: flex-start; background: var(--card); border: 1px solid var(--line); border-radius: 12px; padding: 0.8rem; }
.run.none { border-style: dashed; }
.run img, .no-picture { width: 6.5rem; height: 6.5rem; object-fit: cover; border-radius: 8px; background: var(--ground); flex: none; }
.no-picture { border: 1px dashed var(--line); }
.run .about { flex: 1 1 auto; min-width: 0; }
.run .name { font-weight: 650; font-size: 1.05rem; text-decoration: none; }
.run .name:hover { text-decoration: underline; }
.told { display: -webkit-box; -webkit-line-clamp: 3; -webkit-box-orient: vertical; overflow: hidden; font-size: 0.92rem; }
details:has(> ul.removed) { margin-top: 1.2rem; }
ul.removed { list-style: none; padding: 0; max-width: 40rem; }
ul.removed li { padding: 0.3rem 0; border-bottom: 1px solid var(--line); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 0.95rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 0.35rem 0.6rem; border-bottom: 1px solid var(--line); vertical-align: middle; }
thead th { color: var(--quiet); font-size: 0.88rem; white-space: nowrap; }
tbody th { font-weight: 550; }
.figures th { overflow-wrap: break-word; }
th.group { color: var(--quiet); padding-top: 0.9rem; }
td.num { text-align: right; white-space: nowrap; }
img.small { width: 3rem; height: 3rem; object-fit: cover; border-radius: 5px; display: block; background: var(--ground); }
img.absent { visibility: hidden; }
.source { display: block; color: var(--quiet); font-size: 0.82rem; }
[aria-busy="true"] table { opacity: 0.55; }
.fields { display: flex; flex-wrap: wrap; gap: 0.9rem 1.4rem; margin: 0.9rem 0; align-items: flex-start; }
.field { display: flex; flex-direction: column; gap: 0.2rem; max-width: 20rem; }
.field label { font-weight: 600; font-size: 0.92rem; }
.field.check { flex-direction: row; align-items: center; align-self: center; }
details .field { max-width: 40rem; margin-top: 0.5rem; }
.warnings { max-width: 80ch; padding-left: 1.2rem; }
div.warnings { padding: 0; }
.beside { display: flex; flex-wrap: wrap; gap: 1.5rem; align-items: flex-start; }
.stages { list-style: none; padding: 0; margin: 0; flex: 1 1 24rem; }
.stages li { display: grid; grid-template-columns: 1.6rem 1fr auto; gap: 0 0.5rem; padding: 0.45rem 0; border-bottom: 1px solid var(--line); }
.stages .mark { color: var(--quiet); }
.stages .done .mark { color: var(--good); }
.stages .running .mark, .stages .running .stage { color: var(--accent); font-weight: 650; }
.stages .waiting .stage { color: var(--quiet); }
.stages .quiet { grid-column: 2; grid-row: 2; }
.stages .time { font-variant-numeric: tabular-nums; grid-column: 3; grid-row: 1; }
.preview { width: min(420px, 100%); aspect-ratio: 1; background: #0d1117; border-radius: 10px; display: block; touch-action: none; cursor: grab; }
.viewer-place { min-height: 20rem; margin: 1rem 0; }
.notices { position: fixed; right: 1rem; bottom: 1rem; width: min(30rem, calc(100vw - 2rem)); display: grid; gap: 0.6rem; z-index: 20; }
.notice { display: flex; gap: 0.8rem; align-items: flex-start; background: var(--card); border: 1px solid var(--field); border-left: 5px solid var(--accent); border-radius: 8px; padding: 0.6rem 0.8rem; box-shadow: 0 4px 18px rgb(0 0 0 / 0.25); }
.notice p { flex: 1 1 auto; }
.notice.bad { border-left-color: var(--bad); }
.trouble { background: var(--bad-ground); color: var(--bad); margin: 0; padding: 0.6rem 1.5rem; font-weight: 600; }
@media (prefers-reduced-motion: no-preference) { .stages .running .mark { animation: pulse 1.6s ease-in-out infinite; } }
@keyframes pulse { 50% { opacity: 0.35; } }
`;
