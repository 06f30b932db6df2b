"""The report as one HTML page with plots, which needs nothing from anywhere else."""

import io
from html import escape
from typing import Any

STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse;margin:1rem 0}td,th{border:1px solid #ccc;padding:.2rem .6rem;text-align:left}"
    "svg{max-width:100%;height:auto}"
)


def page(figures: dict[str, Any]) -> str:
    """The page of a report's figures."""
    from drone_env.llm.report import markdown

    body: list[str] = []
    in_table = False
    for line in markdown(figures).splitlines():
        row = line.startswith("|")
        if in_table and not row:
            body.append("</table>")
        if row and not in_table:
            body.append("<table>")
        in_table = row
        if (row and set(line) > set("|-")) or (row and line == "| | |"):
            cells = [escape(cell.strip()) for cell in line.strip("|").split("|")]
            if any(cells):
                body.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
        elif line.startswith("#"):
            level = len(line) - len(line.lstrip("#"))
            body.append(f"<h{level}>{escape(line.lstrip('# '))}</h{level}>")
            if level == 1:
                body.append(_plots(figures))
        elif line and not row:
            body.append(f"<p>{escape(line.replace('**', ''))}</p>")
    if in_table:
        body.append("</table>")
    title = escape(f"{figures['config']['model']} on {figures['config']['task']}")
    return (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{STYLE}</style></head><body>\n" + "\n".join(body) + "\n</body></html>\n"
    )


def _plots(figures: dict[str, Any]) -> str:
    """Scores beside the other agents', and how the answers came out, as SVG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    bars = {"this model": figures["score"], **figures["baselines"]}
    known = {name: score for name, score in bars.items() if score is not None}
    left.bar(list(known), list(known.values()), color=["#d95f02", *["#7570b3"] * (len(known) - 1)])
    left.set_ylim(0, 1)
    left.set_title("mean score, same maps")
    turns = {name: count for name, count in figures["turns"].items() if count}
    right.barh(list(turns), list(turns.values()), color="#1b9e77")
    right.set_title("how requests for actions came out")
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = text.getvalue()
    return svg[svg.index("<svg") :]
