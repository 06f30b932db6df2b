"""The page."""

import re
from html import escape

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse

from drone_env.flights.provenance import HUMAN
from drone_env.server import daily
from drone_env.server.page_files import PAGE, edition, is_bundled
from drone_env.server.state import AppStateDep

router = APIRouter(tags=["page"])
SHEETS = re.compile('(<link rel="stylesheet" .*\n)+')


@router.get("/", include_in_schema=False)
def page(request: Request, app_state: AppStateDep) -> Response:
    """The page; without a query it greets the visitor before its scripts run."""
    app_state.workers.warm_up()
    html = (PAGE / "index.html").read_text(encoding="utf-8").replace("<!-- base -->", escape(str(request.base_url)))
    if is_bundled():
        html = SHEETS.sub('<link rel="stylesheet" href="static/bundle/page.css">\n', html)
        html = html.replace("static/js/main.js", "static/bundle/main.js")
    if request.url.query:
        html = html.replace('id="hello"', 'id="hello" hidden')
    html = html.replace("<!-- today -->", _today())
    html = html.replace('="static/', f'="static/v-{edition()}/')
    return HTMLResponse(html)


def _today() -> str:
    """The link to the map of the day."""
    day = daily.today()
    task, seed = daily.map_of_the_day(day)
    link = f"?task={task}&seed={seed}&pilot={HUMAN}"
    return f'<a class="button" href="{escape(link)}">Map of the day, {day.day} {day:%B}</a>'
