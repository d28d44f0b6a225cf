"""Looks and behaviour of the report page: no address in it leaves the page."""

# Series colours are Okabe and Ito's, which people with any common colour vision can tell apart.
STYLE = """
:root { color-scheme: light dark;
  --paper: #fbfaf7; --ink: #1d1f21; --soft: #62666b; --line: #dedbd3; --card: #ffffff; --accent: #0072b2;
  --series-0: #0072b2; --series-1: #d55e00; --series-2: #009e73; --series-3: #cc79a7;
  --series-4: #e69f00; --series-5: #56b4e9; --series-6: #7f6a3f; --series-7: #444444; }
@media (prefers-color-scheme: dark) { :root {
  --paper: #15171a; --ink: #e9e7e2; --soft: #9aa0a6; --line: #33373c; --card: #1d2024; --accent: #56b4e9;
  --series-0: #56b4e9; --series-1: #ff8c42; --series-2: #2fc99a; --series-3: #e5a3c8;
  --series-4: #f0b93a; --series-5: #4d8fd1; --series-6: #c9b27c; --series-7: #cccccc; } }
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
a { color: var(--accent); text-decoration: none; } a:hover { text-decoration: underline; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(190px, 1fr)); gap: .9rem; margin: 1.6rem 0; }
.tile { background: var(--card); border: 1px solid var(--line); border-radius: 12px; padding: .9rem 1.1rem; }
.tile b { display: block; font-size: 1.9rem; font-weight: 650; line-height: 1.2; font-variant-numeric: tabular-nums; }
.tile i { font-size: .95rem; font-style: normal; font-weight: 400; color: var(--soft); white-space: nowrap; }
.tile span { font-size: .9rem; } .tile small { display: block; font-size: .8rem; margin-top: .3rem; }
.scroll { overflow-x: auto; margin: .6rem 0 1.2rem; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; min-width: 26rem; }
th, td { padding: .38rem .9rem .38rem 0; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
th { font-weight: 600; color: var(--soft); } th:first-child, td:first-child { text-align: left; }
td small { color: var(--soft); }
tr.baseline td { color: var(--soft); font-style: italic; }
details { border-top: 1px solid var(--line); padding: .6rem 0; } summary { cursor: pointer; font-weight: 600; }
img { display: block; max-width: 100%; } .pixels { image-rendering: pixelated; }
.seeds { display: grid; grid-template-columns: repeat(auto-fill, minmax(300px, 1fr)); gap: .9rem; margin: 1rem 0; }
figure { margin: 0; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: 12px; padding: .6rem; }
.card img { width: 100%; border-radius: 6px; }
figcaption { font-size: .82rem; margin-top: .4rem; font-variant-numeric: tabular-nums; }
.chosen { border: 2px solid var(--accent); } .chosen figcaption b { color: var(--accent); }
.examples { display: grid; grid-template-columns: repeat(auto-fill, minmax(320px, 1fr)); gap: .9rem; margin: 1rem 0; }
.four { display: grid; grid-template-columns: repeat(4, minmax(0, 1fr)); gap: 5px; }
.four span { font-size: .7rem; color: var(--soft); text-align: center; line-height: 1.2; }
.tables { display: grid; grid-template-columns: repeat(auto-fill, minmax(180px, 1fr)); gap: .9rem; margin: 1rem 0; }
.frames { aspect-ratio: 1; width: 100%; background-size: auto 100%; background-repeat: no-repeat; touch-action: pan-y;
  cursor: ew-resize; border-radius: 6px; }
.turntable input { width: 100%; accent-color: var(--accent); margin: .4rem 0 0; }
.strip { overflow-x: auto; } .strip img { height: 96px; max-width: none; }
.charts { display: grid; grid-template-columns: repeat(auto-fill, minmax(300px, 1fr)); gap: .9rem; margin: 1rem 0; }
.chart { background: var(--card); border: 1px solid var(--line); border-radius: 12px; padding: .6rem; }
svg { display: block; width: 100%; height: auto; }
svg text { font-size: 12px; fill: var(--soft); } svg .name { font-size: 13px; fill: var(--ink); }
.grid { stroke: var(--line); } .axis { stroke: var(--soft); }
polyline { fill: none; stroke-width: 1.8; stroke-linejoin: round; } .guide { stroke-width: 1.4; stroke-dasharray: 5 4; }
.dot { fill-opacity: .55; stroke: none; } .bar { stroke: none; }
.legend { display: flex; flex-wrap: wrap; gap: .2rem .9rem; font-size: .8rem; color: var(--soft); }
.swatch { display: inline-block; width: .8em; height: .8em; border-radius: 2px; margin-right: .35em; }
""" + "".join(
    f".series-{index} {{ stroke: var(--series-{index}); }} "
    f".dot.series-{index}, .bar.series-{index} {{ fill: var(--series-{index}); }} "
    f".swatch.series-{index} {{ background: var(--series-{index}); }}\n"
    for index in range(8)
)

# A turntable is one wide picture of which one frame shows; the slider, a drag or the first seconds choose the frame.
SCRIPT = """
for (const table of document.querySelectorAll('.turntable')) {
  const frames = table.querySelector('.frames'), slider = table.querySelector('input');
  const count = Number(slider.max) + 1;
  const show = () => { frames.style.backgroundPositionX = 100 * slider.value / (count - 1) + '%'; };
  const turn = by => { slider.value = ((Number(slider.value) + by) % count + count) % count; show(); };
  let held = null, touched = matchMedia('(prefers-reduced-motion: reduce)').matches;
  slider.addEventListener('input', () => { touched = true; show(); });
  frames.addEventListener('pointerdown', event => {
    touched = true; held = event.clientX; frames.setPointerCapture(event.pointerId); });
  frames.addEventListener('pointermove', event => {
    const by = held === null ? 0 : Math.trunc((event.clientX - held) / 8);
    if (by) { held = event.clientX; turn(-by); } });
  frames.addEventListener('pointerup', () => { held = null; });
  setInterval(() => { if (!touched) turn(1); }, 140);
  show();
}
"""
