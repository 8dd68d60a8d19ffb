"""The pieces of a report's page: one HTML file that needs nothing else, no script, no network.

It follows the reader's light or dark colours, and reads on a phone: tables scroll in their own box, charts stack.
"""

from __future__ import annotations

import html
from collections.abc import Sequence

from eagor.evaluation.sheets import Box, Row, Sheet

# Eight hues that stay apart for the colour-blind and have at least 3:1 contrast on their ground (after Okabe and Ito),
# and those of methods that are rarely among them.
_LIGHT = {
    "eagor": "#005fa3", "eagor_paper": "#c44e00", "centroid": "#a8467f", "cent_circ": "#866400", "grid": "#007a5a",
    "vmf": "#2f3440", "grid_filter": "#3d84c6", "particle_filter": "#71767f", "oracle": "#2f3440",
    "plain": "#a3333d",
}  # fmt: skip
_DARK = {
    "eagor": "#5cb8f5", "eagor_paper": "#ff8f45", "centroid": "#e79bca", "cent_circ": "#e8d44d", "grid": "#34cfa3",
    "vmf": "#e9ebf0", "grid_filter": "#9fb6ff", "particle_filter": "#a4a9b3", "oracle": "#e9ebf0",
    "plain": "#f28b92",
}  # fmt: skip


def _palette(colours: dict[str, str], inside: str = "") -> str:
    named = "".join(f"{inside}.s-{name}{{--c:{colour}}}" for name, colour in colours.items())
    spare = "".join(f"{inside}.s-x{k}{{--c:{colour}}}" for k, colour in enumerate(list(colours.values())[:8]))
    return named + spare


_STYLE = """
:root{color-scheme:light dark;--ink:#1d222c;--quiet:#566070;--paper:#fff;--rule:#dde1e8;--ours:#e6f2fa;--warn:#fff3d6;
--target:#c2185b}
*{box-sizing:border-box}
body{font:16px/1.55 system-ui,-apple-system,"Segoe UI",sans-serif;color:var(--ink);background:var(--paper);
max-width:1120px;margin:0 auto;padding:1.5rem 1rem 4rem}
h1{font-size:1.65rem;line-height:1.25;margin:.4rem 0}h2{font-size:1.25rem;margin:2.6rem 0 .4rem}
h3{font-size:1.02rem;margin:1.4rem 0 .3rem}
a{color:inherit}p,li{max-width:46rem}.quiet,.note{color:var(--quiet);font-size:.9rem}.note{margin:.3rem 0}
.warn{background:var(--warn);padding:.6rem .9rem;border-radius:6px}
nav ul{display:flex;flex-wrap:wrap;gap:.2rem 1.1rem;padding:0;list-style:none;font-size:.95rem}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.15rem 1rem;font-size:.92rem}
dt{color:var(--quiet)}dd{margin:0;overflow-wrap:anywhere}
.scroll{overflow-x:auto;border:1px solid var(--rule);border-radius:6px;margin:.5rem 0}
table{border-collapse:collapse;width:100%;font-size:.92rem;font-variant-numeric:tabular-nums}
caption{text-align:left;font-weight:600;padding:.6rem .7rem .3rem;position:sticky;left:0}
th,td{padding:.35rem .7rem;text-align:right;border-top:1px solid var(--rule);white-space:nowrap;vertical-align:top}
thead th{font-weight:600;vertical-align:bottom}tbody th{font-weight:500;text-align:left}
th:first-child{text-align:left;position:sticky;left:0;background:var(--paper);z-index:1}
td small{display:block;color:var(--quiet);font-size:.78rem;line-height:1.25}
tr.ours>*{background:var(--ours)}tr.ours th{font-weight:700}
tr.paper>*{color:var(--quiet);border-top-style:none;font-style:italic;padding-top:0}tr.paper th{padding-left:1.5rem}
.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,340px),1fr));gap:1rem;align-items:start}
.strip{grid-template-columns:repeat(auto-fit,minmax(min(100%,300px),1fr))}
figure{margin:0}.figures>figure:only-child{max-width:560px}figcaption{font-size:.88rem;color:var(--quiet);margin-top:.2rem}
svg{width:100%;height:auto;display:block}svg text{font:12px system-ui,sans-serif;fill:var(--quiet)}
svg .label{fill:var(--ink)}.rule{stroke:var(--rule)}
.event{stroke:var(--quiet);stroke-dasharray:2 3;fill:none}text.event{stroke:none;fill:var(--quiet);font-size:11px}
.line{fill:none;stroke:var(--c);stroke-width:1.7;stroke-linejoin:round}.strong{stroke-width:3.2}
.band{fill:var(--c);opacity:.13}.mark{fill:var(--c);stroke:var(--paper);stroke-width:.8}
.open.mark{fill:none;stroke:var(--c);stroke-width:1.8}
.legend{display:flex;flex-wrap:wrap;gap:.1rem 1.1rem;list-style:none;padding:0;margin:.4rem 0;font-size:.9rem}
.legend svg{display:inline-block;width:36px;height:12px;vertical-align:middle}
.plan{image-rendering:pixelated}.map{max-width:560px}.map svg{max-height:80vh}
.target{fill:none;stroke:var(--target);stroke-width:3}.ball{fill:none;stroke:var(--target);stroke-dasharray:3 4;
stroke-width:2}
rect.stop{fill:var(--paper);stroke:var(--ink);stroke-width:1.5}text.stop{fill:var(--ink);font-weight:700}
.strip svg{border-radius:4px}.truth{fill:none;stroke:#fff;stroke-width:2.6}.truth.below{stroke:#111;stroke-width:5}
.below .mark{fill:#fff;stroke:#fff;stroke-width:3}.below .open.mark{fill:none;stroke-width:5}
.said .mark{stroke:none}.said .open.mark{stroke:var(--c);stroke-width:2.4}
details{margin:.5rem 0}summary{cursor:pointer}code{font-size:.9em}
@media (max-width:40rem){tbody th:first-child{white-space:normal;min-width:10rem}}
"""
STYLE = (
    f"{_STYLE}{_palette(_LIGHT)}@media (prefers-color-scheme:dark){{:root{{--ink:#e6e9ef;--quiet:#a3acba;"
    f"--paper:#14171d;--rule:#333a46;--ours:#17303f;--warn:#4a3a12;--target:#ff6fa5}}{_palette(_DARK)}"
    f"{_palette(_LIGHT, '.strip ')}"  # there they lie on photographs, with a white rim
    "}@media print{.scroll{overflow:visible}}"
)


def document(title: str, lead: str, sections: Sequence[tuple[str, str, str]], foot: str) -> str:
    """The page: a title, what stands before the contents, and sections of id, heading, content."""
    links = "".join(f'<li><a href="#{name}">{html.escape(heading)}</a></li>' for name, heading, _ in sections)
    body = "\n".join(
        f'<section aria-labelledby="{name}"><h2 id="{name}">{html.escape(heading)}</h2>\n{content}\n</section>'
        for name, heading, content in sections
    )
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><title>{html.escape(title)}</title><style>{STYLE}</style></head>
<body><header><h1>{html.escape(title)}</h1>
{lead}</header>
<nav aria-label="Contents"><ul>{links}</ul></nav>
<main>
{body}
</main>
<footer class="quiet"><p>{html.escape(foot)}</p></footer>
</body></html>
"""


def table(sheet: Sheet) -> str:
    """A table with its notes."""
    heads = "".join(f'<th scope="col">{html.escape(head)}</th>' for head in sheet.heads)
    rows = "".join(map(_row, sheet.rows))
    notes = "".join(f'<p class="note">{html.escape(note)}</p>' for note in sheet.notes)
    return (
        f'<div class="scroll" role="region" tabindex="0" aria-label="{html.escape(sheet.title)}"><table>'
        f"<caption>{html.escape(sheet.title)}</caption><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>"
        f"{notes}"
    )


def facts(pairs: Sequence[tuple[str, str]]) -> str:
    """Names and what they are."""
    return f"<dl>{''.join(f'<dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd>' for name, value in pairs)}</dl>"


def figures(pictures: Sequence[tuple[str, str]], kind: str = "") -> str:
    """Pictures (SVG) with their captions, side by side where there is room."""
    found = "".join(
        f"<figure>{picture}<figcaption>{html.escape(caption)}</figcaption></figure>" for picture, caption in pictures
    )
    return f'<div class="figures {kind}">{found}</div>'


def heading(text: str) -> str:
    """A heading below a section's own."""
    return f"<h3>{html.escape(text)}</h3>"


def paragraph(text: str, kind: str = "") -> str:
    """Plain words."""
    return f'<p class="{kind}">{html.escape(text)}</p>' if kind else f"<p>{html.escape(text)}</p>"


def details(summary: str, content: str) -> str:
    """What is there for those who ask."""
    return f"<details><summary>{html.escape(summary)}</summary>{content}</details>"


def items(texts: Sequence[str]) -> str:
    """A list."""
    return f"<ul>{''.join(f'<li>{html.escape(text)}</li>' for text in texts)}</ul>"


def _row(row: Row) -> str:
    kind = f' class="{row.kind}"' if row.kind else ""
    return f'<tr{kind}><th scope="row">{html.escape(row.head)}</th>{"".join(map(_box, row.boxes))}</tr>'


def _box(box: Box) -> str:
    text = html.escape(box.text)
    text = f"<b>{text}</b>" if box.best else text
    if len(box.mark) == 1:
        text += (
            f'<sup title="{"worse" if box.mark == "†" else "better"} than what it is compared with">{box.mark}</sup>'
        )
    small = " ".join(part for part in (box.small, f"· {box.mark}" if len(box.mark) > 1 else "") if part)
    return f"<td>{text}{f'<small>{html.escape(small)}</small>' if small else ''}</td>"
