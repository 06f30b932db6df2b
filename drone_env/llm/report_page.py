"""The report as one HTML page with plots, which needs nothing from anywhere else and runs nothing."""

from html import escape
from pathlib import Path
from typing import Any

from drone_env.llm.report_plots import plots
from drone_env.llm.report_tables import ReportTable, maps_line, percent, shown, tables, title, verdict, with_interval

STYLE = Path(__file__).with_name("report.css")
FOLDED_ROWS = 30
"""Longer tables are folded."""


def page(figures: dict[str, Any]) -> str:
    """The page of a report's figures."""
    config = figures["config"]
    reason = f"<p class='reason'>{escape(figures['reason'])}</p>" if figures["reason"] else ""
    drawn = "".join(f"<figure><figcaption>{escape(name)}</figcaption>{svg}</figure>" for name, svg in plots(figures))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">"
        f"<title>{escape(title(figures))}</title><style>{STYLE.read_text(encoding='utf-8')}</style></head>\n<body>\n"
        f"<header><h1>{escape(config['model'])}</h1>"
        f"<p>{escape(config['task'])}, prompt {escape(config['prompt'])}. {escape(maps_line(figures))}</p>"
        f"<span class='verdict {escape(figures['verdict'])}'>{escape(verdict(figures))}</span>{reason}</header>\n"
        f"<section class='cards'>{_cards(figures)}</section>\n<section class='plots'>{drawn}</section>\n"
        f"<section class='tables'>{''.join(map(_table, tables(figures)))}</section>\n</body></html>\n"
    )


def _cards(figures: dict[str, Any]) -> str:
    """The figures that matter most."""
    tokens, cost = figures["tokens"], figures["cost_usd"]
    cards = [
        (with_interval(figures), "mean score, 95 % interval"),
        (percent(figures["success_rate"]), "delivered everything"),
        (shown(figures["regret"]), "regret: what lacks to the optimum"),
        (shown(figures["normalised"]), "of the way from random to optimal"),
        (f"{tokens['prompt'] + tokens['completion']:,}", "tokens" + ("" if cost is None else f", ${cost:.4f}")),
    ]
    return "".join(f"<div><b>{escape(figure)}</b><span>{escape(name)}</span></div>" for figure, name in cards)


def _table(table: ReportTable) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in table.head)
    rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows)
    body = f"<table>{f'<thead><tr>{head}</tr></thead>' if head else ''}<tbody>{rows}</tbody></table>"
    wide = " class='wide'" if len(table.head) > 2 else ""
    if len(table.rows) > FOLDED_ROWS:
        heading = f"<summary><h2>{escape(table.title)}</h2> {len(table.rows)} rows</summary>"
        return f"<article{wide}><details>{heading}{body}</details></article>"
    return f"<article{wide}><h2>{escape(table.title)}</h2>{body}</article>"
