"""The report's style sheet, a module of its own so that no file has to be found at run time."""

STYLE = """\
:root {
  --ground: #f5f6f8; --card: #ffffff; --ink: #1b2129; --quiet: #5d6773; --line: #dfe3e8;
  --accent: #1f6fc4; --good: #176f43; --warn: #8a5200; --bad: #b3261e;
  --good-ground: #e4f4ec; --warn-ground: #fdf1dc; --bad-ground: #fbe6e4;
}
@media (prefers-color-scheme: dark) {
  :root:not([data-theme="light"]) {
    --ground: #0f1318; --card: #171c23; --ink: #e6eaef; --quiet: #98a3b0; --line: #2a323c;
    --accent: #69aef5; --good: #6fd3a0; --warn: #f0bd6a; --bad: #ff9a91;
    --good-ground: #14291f; --warn-ground: #2d2413; --bad-ground: #331a18;
  }
}
:root[data-theme="dark"] {
  --ground: #0f1318; --card: #171c23; --ink: #e6eaef; --quiet: #98a3b0; --line: #2a323c;
  --accent: #69aef5; --good: #6fd3a0; --warn: #f0bd6a; --bad: #ff9a91;
  --good-ground: #14291f; --warn-ground: #2d2413; --bad-ground: #331a18;
}
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--ground); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
}
main { max-width: 1120px; margin: 0 auto; padding: 28px 20px 48px; }
header { margin-bottom: 20px; }
h1 { font-size: 27px; line-height: 1.2; margin: 2px 0 4px; letter-spacing: -0.01em; overflow-wrap: anywhere; }
h2 { font-size: 18px; margin: 0 0 12px; }
h3 { font-size: 13px; margin: 0 0 4px; color: var(--quiet); font-weight: 600; }
p { margin: 6px 0; }
.brand { color: var(--accent); font-weight: 700; margin: 0; }
.brand span { color: var(--quiet); font-weight: 400; }
.quiet { color: var(--quiet); font-size: 13.5px; }
.basis { max-width: 75ch; }
.verdict { margin: 14px 0 8px; padding: 9px 14px; border-radius: 8px; font-weight: 600; }
.verdict.plain { background: var(--card); border: 1px solid var(--line); }
.verdict.good { background: var(--good-ground); color: var(--good); }
.verdict.warn { background: var(--warn-ground); color: var(--warn); }
.verdict.bad { background: var(--bad-ground); color: var(--bad); }
section {
  background: var(--card); border: 1px solid var(--line); border-radius: 12px; padding: 18px 20px; margin: 16px 0;
}
.notice ul { margin: 0; padding-left: 20px; overflow-wrap: anywhere; }
.notice h2 { font-size: 15px; margin-bottom: 4px; }
.notice.warn h2 { color: var(--warn); }
.notice.bad h2 { color: var(--bad); }
.tiles {
  display: flex; flex-wrap: wrap; gap: 1px; margin: 16px 0;
  background: var(--line); border: 1px solid var(--line); border-radius: 12px; overflow: hidden;
}
.tiles div { background: var(--card); padding: 12px 16px; flex: 1 1 210px; }
.tiles dt { color: var(--quiet); font-size: 13px; }
.tiles dd { margin: 2px 0 0; font-size: 20px; font-weight: 600; font-variant-numeric: tabular-nums; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 14px; font-variant-numeric: tabular-nums; }
th, td { padding: 6px 10px; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
tr > :first-child { padding-left: 0; }
tr > :last-child { padding-right: 0; }
tbody tr:last-child > * { border-bottom: 0; }
thead th { color: var(--quiet); font-weight: 600; font-size: 13px; vertical-align: bottom; }
.scroll + h3, details + h3, p + h3 { margin-top: 18px; }
tbody th { font-weight: 500; overflow-wrap: anywhere; min-width: 8em; }
td.num { white-space: nowrap; }
.num { text-align: right; }
td.bar { width: 16%; min-width: 70px; vertical-align: middle; }
td.bar span { display: block; height: 8px; border-radius: 4px; background: var(--accent); min-width: 2px; }
figure { margin: 0; }
figure img { display: block; width: 100%; height: auto; }
.wide { margin: 8px 0 14px; }
.wide img { max-width: 960px; margin: 0 auto; }
.two { display: grid; grid-template-columns: repeat(auto-fit, minmax(320px, 1fr)); gap: 20px; align-items: start; }
figcaption { color: var(--quiet); font-size: 13.5px; margin-top: 4px; }
figcaption b { color: var(--ink); font-weight: 600; }
.options { columns: 3 240px; column-gap: 32px; }
.options > div { break-inside: avoid; margin-bottom: 14px; }
.options dl { display: grid; grid-template-columns: auto auto; gap: 1px 12px; margin: 0; font-size: 13px; }
.options dt { color: var(--quiet); }
.options dd { margin: 0; text-align: right; overflow-wrap: anywhere; }
code { font: 13px ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; }
.surface { padding: 0; overflow: visible; }
.surface > h2 { padding: 16px 20px 0; }
.surface > .still { padding: 0 20px 18px; }
@media (min-width: 1240px) {
  .surface { --beyond: calc((1080px - min(100vw - 48px, 1560px)) / 2); margin: 16px var(--beyond); }
}
.has-viewer .still { display: none; }
.held { position: absolute; width: 0; height: 0; }
.pairs { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(440px, 100%), 1fr)); gap: 16px 20px; }
.held + .pairs { margin-top: 14px; }
.pairs svg { display: block; width: 100%; height: auto; border-radius: 6px; background: #0006; }
.pairs path { fill: none; stroke-linecap: round; }
.pairs .lines { opacity: 0.7; }
.pairs figcaption { overflow-wrap: anywhere; margin-bottom: 4px; }
section > ul { padding-left: 20px; margin: 12px 0 0; }
a { color: var(--accent); }
pre { font: 12.5px/1.45 ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; overflow: auto; max-height: 60vh; }
summary { cursor: pointer; }
@page { margin: 14mm; }
@media print {
  :root, :root[data-theme] {
    --ground: #fff; --card: #fff; --ink: #000; --quiet: #444; --line: #bbb; --accent: #1f6fc4;
    --good: #14603a; --warn: #7a4800; --bad: #8f1d17; --good-ground: #fff; --warn-ground: #fff; --bad-ground: #fff;
  }
  body { font-size: 11px; }
  main { max-width: none; padding: 0; }
  section { border: 0; padding: 0; margin: 14px 0; }
  figure, tr, .tiles div { break-inside: avoid; }
  .verdict { border: 1px solid currentColor; }
  table { font-size: 10.5px; }
  .options dl { font-size: 10px; }
  .has-viewer .still { display: block; padding: 0; }
  .surface { margin: 14px 0; }
  .surface > h2 { padding: 0; }
  #semscape-viewer { display: none; }
  .scroll { overflow: visible; }
  h2, h3 { break-after: avoid; }
  .surface .wide img { max-width: 125mm; }
  .pairs { grid-template-columns: 1fr 1fr; gap: 8px 12px; }
  pre { max-height: none; white-space: pre-wrap; }
  a { color: inherit; }
}
"""
