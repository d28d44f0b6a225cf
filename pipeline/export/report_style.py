"""Looks of the report page."""

# Series colours are Okabe and Ito's, moved apart until people with any common colour vision can tell all eight of them.
STYLE = """
:root { color-scheme: light dark;
  --paper: #fbfaf7; --ink: #1d1f21; --soft: #62666b; --line: #dedbd3; --card: #ffffff; --accent: #0072b2;
  --series-0: #005ea9; --series-1: #ba3a00; --series-2: #0caa56; --series-3: #cd78a7;
  --series-4: #d97d00; --series-5: #5990ff; --series-6: #6b5534; --series-7: #3a3f3d; }
@media (prefers-color-scheme: dark) { :root {
  --paper: #15171a; --ink: #e9e7e2; --soft: #9aa0a6; --line: #33373c; --card: #1d2024; --accent: #56b4e9;
  --series-0: #4795ff; --series-1: #f06c2d; --series-2: #43ecae; --series-3: #c284b1;
  --series-4: #ecca22; --series-5: #5c6cb1; --series-6: #cdd478; --series-7: #c1e9f0; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 2.5rem 1.25rem 5rem; }
h1 { font-size: clamp(1.7rem, 5vw, 2.5rem); line-height: 1.15; margin: 0 0 .4rem; letter-spacing: -.02em; }
h2 { font-size: 1.35rem; margin: 3.2rem 0 .4rem; letter-spacing: -.01em; }
h3 { font-size: 1rem; margin: 1.6rem 0 .5rem; }
p { margin: .3rem 0 1rem; max-width: 46rem; }
.lead, .note, figcaption, .tile small { color: var(--soft); }
.note { font-size: .875rem; }
nav { display: flex; flex-wrap: wrap; gap: .3rem 1.1rem; font-size: .9rem; margin: 1rem 0 0; }
a { color: var(--accent); }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(190px, 1fr)); gap: .9rem; margin: 1.6rem 0; }
.tile { background: var(--card); border: 1px solid var(--line); border-radius: 12px; padding: .9rem 1.1rem; }
.tile b { display: block; font-size: 1.7rem; font-weight: 650; line-height: 1.2; font-variant-numeric: tabular-nums; }
.tile i { font-size: .95rem; font-style: normal; font-weight: 400; color: var(--soft); white-space: nowrap; }
.tile span { font-size: .9rem; } .tile small { display: block; font-size: .8rem; margin-top: .3rem; }
.scroll { overflow-x: auto; margin: .6rem 0 1.2rem; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; min-width: 26rem; }
th, td { padding: .38rem .6rem .38rem 0; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
th { font-weight: 600; color: var(--soft); } th:first-child, td:first-child { text-align: left; }
td small { color: var(--soft); }
.runs th { white-space: normal; vertical-align: bottom; } .runs td small { display: block; }
:is(th, td):first-child { position: sticky; left: 0; background: var(--paper);
  min-width: 8.5rem; white-space: normal; overflow-wrap: anywhere; }
tr.baseline td { color: var(--soft); font-style: italic; }
details { border-top: 1px solid var(--line); padding: .6rem 0; } summary { cursor: pointer; font-weight: 600; }
img { display: block; max-width: 100%; } .pixels { image-rendering: pixelated; }
.seeds, .charts, .examples { display: grid; gap: .9rem; margin: 1rem 0;
  grid-template-columns: repeat(auto-fill, minmax(min(var(--least, 300px), 100%), 1fr)); }
figure { margin: 0; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: 12px; padding: .6rem; }
.card img { width: 100%; border-radius: 6px; }
figcaption { font-size: .82rem; margin-top: .4rem; font-variant-numeric: tabular-nums; }
.chosen { border: 2px solid var(--accent); } .chosen figcaption b { color: var(--accent); }
.examples { --least: 320px; }
.four { display: grid; grid-template-columns: repeat(4, minmax(0, 1fr)); gap: 5px; }
.four span { font-size: .76rem; color: var(--soft); text-align: center; line-height: 1.2; }
.look { display: grid; grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); gap: 1.2rem; align-items: start; }
.stage { background: radial-gradient(var(--card) 40%, var(--paper)); border: 1px solid var(--line); border-radius: 12px;
  overflow: hidden; }
.stage canvas { display: block; width: 100%; aspect-ratio: 4 / 3; cursor: grab; touch-action: pan-y pinch-zoom;
  border-radius: 12px; outline-offset: -3px; }
.stage canvas:active { cursor: grabbing; } .stage canvas[hidden] { display: none; } .problem { padding: 0 1rem; }
.shown { font-size: 1.15rem; font-weight: 650; margin: 0 0 .5rem; }
.beside p { font-size: .875rem; color: var(--soft); }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: .7rem; margin: 0 0 .5rem; }
.pair img { width: 100%; border-radius: 6px; }
.controls { display: grid; gap: .8rem; } .slider { position: relative; font-size: .875rem; }
.slider output { position: absolute; top: 0; right: 0; font-variant-numeric: tabular-nums; color: var(--soft); }
.slider input { display: block; width: 100%; min-height: 1.75rem; margin: 0; }
input { accent-color: var(--accent); }
fieldset { border: 0; margin: 0; padding: 0; min-width: 0; } legend { padding: 0; font-size: .875rem; }
.surfaces label { display: inline-flex; align-items: center; gap: .35rem; margin-right: 1rem; min-height: 2rem;
  font-size: .875rem; }
.surfaces label:has(:disabled) { color: var(--soft); }
.buttons { display: flex; flex-wrap: wrap; gap: .6rem; }
button { font: inherit; font-size: .875rem; color: var(--ink); background: var(--card); border: 1px solid var(--soft);
  border-radius: 8px; padding: .4rem .9rem; cursor: pointer; }
button[aria-pressed=true] { border-color: var(--accent); box-shadow: inset 0 0 0 1px var(--accent); }
.shelf { display: flex; gap: .5rem; overflow-x: auto; padding: 4px; margin: 1rem -4px 0; }
.shelf legend { font-weight: 600; padding: 0 4px .2rem; }
.choice { flex: none; width: 76px; border: 1px solid var(--line); border-radius: 8px; background: var(--card);
  padding: 4px; cursor: pointer; position: relative; font-size: .76rem; line-height: 1.25; text-align: center;
  color: var(--soft); overflow-wrap: anywhere; }
.choice input { position: absolute; opacity: 0; inset: 0; margin: 0; width: 100%; height: 100%; cursor: pointer; }
.choice img { width: 100%; aspect-ratio: 1; border-radius: 5px; image-rendering: pixelated; margin-bottom: 3px; }
.choice:has(:checked) { border-color: var(--accent); box-shadow: 0 0 0 1px var(--accent); color: var(--ink); }
:focus-visible, .choice:has(:focus-visible) { outline: 3px solid var(--accent); outline-offset: 2px; }
@media (max-width: 700px) { .look { grid-template-columns: minmax(0, 1fr); gap: .8rem; }
  .panel { display: contents; } .shown { order: -1; margin: 0; } .controls { order: 1; } .beside { order: 2; } }
.strip { overflow-x: auto; } .strip img { height: 96px; max-width: none; }
.chart { background: var(--card); border: 1px solid var(--line); border-radius: 12px; padding: .6rem; }
svg { display: block; width: 100%; height: auto; }
svg text { font-size: 15px; fill: var(--soft); } svg .name { font-size: 16px; fill: var(--ink); }
.grid { stroke: var(--line); } .axis { stroke: var(--soft); }
polyline { fill: none; stroke-width: 1.8; stroke-linejoin: round; } .guide { stroke-width: 1.8; }
.dash-1 { stroke-dasharray: 8 4; } .dash-2 { stroke-dasharray: 2 3; } .dash-3 { stroke-dasharray: 8 3 2 3; }
.dash-4 { stroke-dasharray: 14 3; }
.dot { fill-opacity: .55; } .bar.series-1 { fill-opacity: .25; stroke-width: 1.5; }
.legend { display: flex; flex-wrap: wrap; gap: .2rem .9rem; font-size: .8rem; color: var(--soft); }
.key { display: inline-flex; align-items: center; gap: .4em; } .key svg { width: 28px; height: 12px; }
""" + "".join(
    f".series-{index} {{ stroke: var(--series-{index}); }} "
    f".dot.series-{index}, .bar.series-{index} {{ fill: var(--series-{index}); }}\n"
    for index in range(8)
)
